# SPDX-License-Identifier: BSD-3-Clause
"""The equation of motion of a mode whose spring has hysteresis, by the Runge-Kutta rule."""

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray

PHASE_STEP = 0.3
"""Largest angle in rad by which the mode turns in a step of the solution, at its stiffest."""

STIFFEST = 20.0
SOFTEST = 0.05
"""Bounds of the total spring relative to the linear stiffness: within them every load has one
displacement, and every step of the solution is stable."""

FARTHEST = 4.0
"""Force of the hysteresis, in half ranges, above which its slope is constant."""

NEW_STATE = 7
"""Size of the state: the removed displacement, its velocity, the force, three loads, and a flag
that is set after the first sample."""


@njit(cache=True, nogil=True)
def slope_of_force(force: float, direction: float, half_range: float, linear: float,
                   stiffness: float, beta: float, gamma: float, exponent: float) -> float:
    """Return the slope of the hysteretic force over the displacement.

    The force is over the stiffness of the linear spring, as a displacement in um. Only the sign of
    the direction of the motion is used. The other arguments are parameters of
    `piezo_models.effects.hysteretic_spring.HystereticSpring`.
    """
    size = min(abs(force) / half_range, FARTHEST)
    part = size if exponent == 1.0 else size**exponent
    turned = beta if direction * force > 0.0 else -beta
    slope = stiffness - (turned + gamma) * part
    return min(max(slope, SOFTEST - 1.0 - linear), STIFFEST - 1.0 - linear)


@njit(cache=True, nogil=True)
def swing(loads: FloatArray, state: FloatArray, centre: float, half_range: float,
          parts: FloatArray, damping_ratio: float, step_rad: float, substeps: int) -> FloatArray:
    """Return the displacement of the mode with its hysteretic spring (um); overwrite the state.

    The loads, (N,), are the displacement in um without the force. The state, (NEW_STATE,), is zero
    at first, except the three loads, which are the level at rest. The parts, (6,), are linear,
    viscous, stiffness, beta, gamma and exponent. In each step, of which a sample period has some,
    the mode turns by an angle in rad.
    """
    linear, viscous = parts[0], parts[1]
    stiffness, beta, gamma, exponent = parts[2], parts[3], parts[4], parts[5]
    taken, speed, force = state[0], state[1], state[2]
    earliest, earlier, last = state[3], state[4], state[5]
    swung = np.empty(loads.size)
    # Slopes of the three states at the four stages of the rule.
    k = np.empty((4, 3))
    for n in range(loads.size):
        load = loads[n]
        # Cubic through the last four samples, by backward differences.
        first = load - last
        second = first - last + earlier
        third = second - last + 2.0 * earlier - earliest
        for substep in range(substeps):
            for place in range(4):
                part = 0.0 if place == 0 else 1.0 if place == 3 else 0.5
                x = (substep + part) / substeps - 1.0
                cubic = second + (x + 2.0) / 3.0 * third
                at = load + x * (first + 0.5 * (x + 1.0) * cubic)
                # Per radian: a sample has step_rad * substeps of them.
                rate = (first + (x + 0.5) * cubic + x * (x + 1.0) / 6.0 * third) / (
                    step_rad * substeps)
                ahead = part * step_rad
                u, v, z = taken, speed, force
                if place > 0:
                    u += ahead * k[place - 1, 0]
                    v += ahead * k[place - 1, 1]
                    z += ahead * k[place - 1, 2]
                velocity = rate - v
                whole = linear * (at - u - centre) + viscous * velocity + z
                k[place, 0] = v
                k[place, 1] = whole - u - 2.0 * damping_ratio * v
                k[place, 2] = velocity * slope_of_force(
                    z, velocity, half_range, linear, stiffness, beta, gamma, exponent)
            taken += step_rad / 6.0 * (k[0, 0] + 2.0 * (k[1, 0] + k[2, 0]) + k[3, 0])
            speed += step_rad / 6.0 * (k[0, 1] + 2.0 * (k[1, 1] + k[2, 1]) + k[3, 1])
            force += step_rad / 6.0 * (k[0, 2] + 2.0 * (k[1, 2] + k[2, 2]) + k[3, 2])
        swung[n] = load - taken
        earliest, earlier, last = earlier, last, load
    state[:6] = taken, speed, force, earliest, earlier, last
    return swung


@njit(cache=True, nogil=True)
def force_under(displacements: FloatArray, half_range: float, stiffness: float, beta: float,
                gamma: float, exponent: float) -> FloatArray:
    """Return the hysteretic force under a known displacement, (N,), starting from zero.

    The other arguments are those of `slope_of_force`.
    """
    forces = np.zeros(displacements.size)
    force = 0.0
    for n in range(1, displacements.size):
        move = displacements[n] - displacements[n - 1]
        middle = force + 0.5 * move * slope_of_force(
            force, move, half_range, 0.0, stiffness, beta, gamma, exponent)
        force += move * slope_of_force(
            middle, move, half_range, 0.0, stiffness, beta, gamma, exponent)
        forces[n] = force
    return forces


def substeps_of(phase: float, parts: FloatArray) -> int:
    """Return the steps per sample in which the mode alone turns by a phase in rad."""
    linear, _, stiffness, beta, gamma, _ = parts
    stiffest = min(max(1.0 + linear + stiffness + max(0.0, beta - gamma, -beta - gamma), 1.0),
                   STIFFEST)
    return max(1, int(np.ceil(phase * np.sqrt(stiffest) / PHASE_STEP)))
