# SPDX-License-Identifier: BSD-3-Clause
"""Damping of a mode that grows with the amplitude of its vibration."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numba import njit

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.effects.effect import LEAST, MOST, Evidence, parameter
from piezo_models.effects.filtering import filtered
from piezo_models.effects.swinging_mode import SwingingMode

PHASE_STEP = 0.3
"""Largest angle in rad by which the mode turns in a step of the solution."""

LEAST_SHARE = 0.05
"""The growing part must remove at least this fraction of the residual that a change of the linear
damping leaves, or it is not fitted."""

STRONGEST = 5.0
"""Largest damping by speed, over half the range, for which every step of the solution is stable."""

LEAST_VISCOUS = -1.0
"""Lower bound of the change of the mode's linear damping: minus half of the critical damping."""


@njit(cache=True, nogil=True)
def _damped(loads: FloatArray, state: FloatArray, viscous: float, quadratic: float,
            damping_ratio: float, step_rad: float, substeps: int) -> FloatArray:
    """Simulate the mode under its additional damping; overwrite the state with the final one.

    The state is the displacement that the damping removes, its velocity per radian of the mode, and
    the last two loads. The load is interpolated by a parabola through three samples; the rule is
    that of Runge and Kutta.
    """
    taken, speed, earlier, last = state[0], state[1], state[2], state[3]
    swung = np.empty(loads.size)
    k = np.empty((4, 2))
    for n in range(loads.size):
        load = loads[n]
        first = load - last
        second = first - last + earlier
        for substep in range(substeps):
            for place in range(4):
                part = 0.0 if place == 0 else 1.0 if place == 3 else 0.5
                x = (substep + part) / substeps - 1.0
                rate = (first + (x + 0.5) * second) / (step_rad * substeps)
                u, v = taken, speed
                if place > 0:
                    u += part * step_rad * k[place - 1, 0]
                    v += part * step_rad * k[place - 1, 1]
                velocity = rate - v
                force = (viscous + quadratic * abs(velocity)) * velocity
                k[place, 0] = v
                k[place, 1] = force - u - 2.0 * damping_ratio * v
            taken += step_rad / 6.0 * (k[0, 0] + 2.0 * (k[1, 0] + k[2, 0]) + k[3, 0])
            speed += step_rad / 6.0 * (k[0, 1] + 2.0 * (k[1, 1] + k[2, 1]) + k[3, 1])
        swung[n] = load - taken
        earlier, last = last, load
    state[:] = taken, speed, earlier, last
    return swung


@dataclass(frozen=True)
class AmplitudeDamping(SwingingMode):
    """A mode is damped by the square of its speed, in addition to a change of its linear damping.

    With the displacement x of the linear model and the mode G of frequency w, the displacement y
    solves y = x - G f, with half the range h and
    ``f = viscous y'/w + quadratic |y'| y' / (w^2 h)``.
    """

    name: ClassVar[str] = "amplitude_damping"
    place: ClassVar[str] = "displacement"
    experiment: ClassVar[str] = "a multisine around the mode, at a small and at a large amplitude"
    distortion: ClassVar[frozenset[str] | None] = frozenset({"odd"})

    viscous: float = parameter("1", "linear", LEAST_VISCOUS, STRONGEST)
    quadratic: float = parameter("1", "linear", 0.0, STRONGEST)
    half_range_um: float = parameter("um", "fixed", LEAST, MOST)
    frequency_rad_per_s: float = parameter("rad/s", "fixed", LEAST, MOST)
    damping_ratio: float = parameter("1", "fixed", 0.0, MOST)

    def _at_rest(self, level: float) -> FloatArray:
        return np.array([0.0, 0.0, level, level])

    def _swing(self, loads: FloatArray, state: FloatArray, phase: float) -> FloatArray:
        substeps = max(1, int(np.ceil(phase / PHASE_STEP)))
        return _damped(
            loads, state, self.viscous, self.quadratic / self.half_range_um, self.damping_ratio,
            phase / substeps, substeps)

    def _force(self, wanted: FloatArray, derivative: ComplexArray) -> ComplexArray:
        speed_um = np.fft.irfft(derivative * np.fft.rfft(wanted), wanted.size)
        return np.fft.rfft(
            (self.viscous + self.quadratic / self.half_range_um * np.abs(speed_um)) * speed_um)

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with least squares for each mode that a changed linear damping does not explain.

        Both parts are linear in their parameters if the motion is that of the model.
        """
        travel_um, period_s = evidence.travel_um, evidence.sample_period_s
        if travel_um == 0.0:
            return []
        dynamics = evidence.dynamics
        found: list[tuple[float, Self]] = []
        for w, ratio in zip(dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios,
                            strict=True):
            if w * period_s > 1.0:
                continue
            speed_um = np.gradient(evidence.displacement_um, w * period_s)
            mode = [w * w], [1.0, 2.0 * ratio * w, w * w]
            removed = np.column_stack([
                filtered(*mode, part, period_s)
                for part in (speed_um, 2.0 / travel_um * np.abs(speed_um) * speed_um)])
            _, linear_share = evidence.reduction(-removed[:, :1])
            (viscous, quadratic), share = evidence.reduction(-removed)
            if quadratic > 0.0 and share - linear_share > LEAST_SHARE * (1.0 - linear_share):
                found.append((share, cls(
                    float(np.clip(viscous, max(-2.0 * ratio, LEAST_VISCOUS), STRONGEST)),
                    min(float(quadratic), STRONGEST), 0.5 * travel_um, w, ratio)))
        found.sort(key=lambda entry: -entry[0])
        return [start for _, start in found]
