# SPDX-License-Identifier: BSD-3-Clause
"""The equation of a nonlinear spring, solved sample by sample to rounding accuracy."""

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import ArrayLike
from scipy.linalg import expm

from piezo_common.arrays import FloatArray

SOFTEST = 0.1
"""Smallest slope of the spring, relative to the linear stiffness. Beyond the displacement at which
a polynomial would fall below it, the force is a straight line, so that every load has one
displacement."""

FARTHEST = 4.0
"""Displacement, in half ranges from the middle, beyond which the force is always a straight line: a
fourth power cannot be extrapolated that far beyond the fitted samples."""

PHASE_STEP = 0.3
"""Largest angle in rad by which the mode turns in a step of the solution, at its stiffest. A rule
of fourth order is stable up to 2.8; at this step its error is less than that of the samples."""

VISITED = 1.5
"""Half ranges from the middle within which the largest stiffness is sought."""

MOST_NEWTON_STEPS = 100

ORDER = 5
"""Order of the polynomial that interpolates a load between its samples. For noise up to a third of
the sample rate on a mode at a ninth of it, the error of third order is three to six times as
large."""


def straight_beyond(parts: ArrayLike, half_range_um: float) -> tuple[float, float]:
    """Return the displacements between which the polynomial of a force is valid.

    Beyond them the force is a straight line. They are in half ranges from the middle of the range,
    low <= 0 <= high. The parts, (4,), are the force at the end of the range, as displacement in um,
    for the powers one to four.
    """
    slope = np.arange(1.0, 5.0) * np.asarray(parts, dtype=float) / half_range_um
    roots = np.roots([*slope[:0:-1], slope[0] + 1.0 - SOFTEST])
    real = roots[np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots))].real
    if slope[0] + 1.0 <= SOFTEST:
        return 0.0, 0.0
    low = max([-FARTHEST, *real[real < 0.0]])
    high = min([FARTHEST, *real[real > 0.0]])
    return float(low), float(high)


@njit(cache=True, nogil=True)
def force_and_slope(x: float, parts: FloatArray, low: float,
                    high: float) -> tuple[float, float]:
    """Return the force of the spring in addition to the linear one, and its slope.

    The slope of the whole spring is at least `SOFTEST`; see `straight_beyond` for its parts, and
    for the displacements between which the polynomial is valid. Displacement and force are in half
    ranges.
    """
    inside = min(max(x, low), high)
    force = inside * (parts[0] + inside * (parts[1] + inside * (parts[2] + inside * parts[3])))
    slope = parts[0] + inside * (
        2.0 * parts[1] + inside * (3.0 * parts[2] + inside * 4.0 * parts[3]))
    return force + slope * (x - inside), slope


@njit(cache=True, nogil=True)
def _balanced(load: float, part: float, first: float, centre: float, half_range: float,
              parts: FloatArray, low: float, high: float) -> tuple[float, float]:
    """Solve y + part f(y) = load by Newton steps within a bracket; return y and f(y)."""
    y = first
    force, slope = force_and_slope((y - centre) / half_range, parts, low, high)
    excess = y + part * force - load
    # The left side has at least this slope, which bounds the distance of the solution.
    steepest = 1.0 - part * (1.0 - SOFTEST)
    reach = abs(excess) / steepest * (1.0 + 1e-9)
    below, above = y - reach, y + reach
    for _ in range(MOST_NEWTON_STEPS):
        if excess > 0.0:
            above = y
        else:
            below = y
        step = excess / (1.0 + part * slope / half_range)
        tried = y - step
        if not below < tried < above:
            tried = 0.5 * (below + above)
        if tried == y or excess == 0.0:
            break
        moved = abs(tried - y)
        y = tried
        force, slope = force_and_slope((y - centre) / half_range, parts, low, high)
        excess = y + part * force - load
        if moved <= 4e-16 * (abs(y) + abs(centre) + half_range):
            break
    return y, force


@njit(cache=True, nogil=True)
def _static(loads: FloatArray, centre: float, half_range: float, parts: FloatArray, low: float,
            high: float) -> FloatArray:
    balanced = np.empty(loads.size)
    y = centre
    for n in range(loads.size):
        y, _ = _balanced(loads[n], 1.0, y, centre, half_range, parts, low, high)
        balanced[n] = y
    return balanced


@lru_cache(maxsize=64)
def _within_sample(substeps: int) -> tuple[FloatArray, FloatArray]:
    """Return the matrices from samples to a load and its slope per sample, at half substeps.

    They evaluate Lagrange's polynomial through the last samples, from the one before the newest.
    The shape of both is (2 substeps + 1, ORDER + 1), the newest sample last.
    """
    nodes = np.arange(-float(ORDER), 1.0)
    at = np.linspace(-1.0, 0.0, 2 * substeps + 1)
    powers = np.arange(ORDER + 1)
    to_powers = np.linalg.inv(nodes[:, None] ** powers)
    slopes = powers[1:] * at[:, None] ** powers[:-1]
    return (np.ascontiguousarray(at[:, None] ** powers @ to_powers),
            np.ascontiguousarray(slopes @ to_powers[1:]))


@njit(cache=True, nogil=True)
def _swinging(loads: FloatArray, rest: float, viscous: float, centre: float, half_range: float,
              parts: FloatArray, low: float, high: float, half_step: FloatArray,
              step_rad: float, within: FloatArray, slopes: FloatArray) -> FloatArray:
    """Simulate the mode under the force of its spring by Lawson's form of the Runge-Kutta rule.

    The state is the displacement that the force removes and its velocity. Without the force it is
    propagated exactly: `half_step` is the matrix for half a substep, including the additional
    damping. The part of that damping by the velocity of the load is added to the force. `within`
    and `slopes` are those of `_within_sample`.
    """
    substeps = within.shape[0] // 2
    balanced = np.empty(loads.size)
    # Displacement that the force removes: at rest all of it.
    y, taken = _balanced(rest, 1.0, rest, centre, half_range, parts, low, high)
    speed = 0.0
    a, b, c, d = half_step[0, 0], half_step[0, 1], half_step[1, 0], half_step[1, 1]
    # Response of both at the end to a push at the beginning.
    far, far_speed = a * b + b * d, c * b + d * d
    # The additional damping acts on the velocity of the load.
    damped = viscous / (step_rad * substeps)
    known = np.full(within.shape[1], rest)
    load, push_of_speed = np.empty(within.shape[0]), np.empty(within.shape[0])
    for n in range(loads.size):
        known[:-1] = known[1:]
        known[-1] = loads[n]
        for half in range(load.size):
            value, slope = 0.0, 0.0
            for node in range(known.size):
                value += within[half, node] * known[node]
                slope += slopes[half, node] * known[node]
            load[half], push_of_speed[half] = value, damped * slope
        for substep in range(substeps):
            begin, middle, end = load[2 * substep], load[2 * substep + 1], load[2 * substep + 2]
            begin_push, middle_push, end_push = (
                push_of_speed[2 * substep], push_of_speed[2 * substep + 1],
                push_of_speed[2 * substep + 2])
            push, _ = force_and_slope((begin - taken - centre) / half_range, parts, low, high)
            push = step_rad * (push + begin_push)
            own, own_speed = a * taken + b * speed, c * taken + d * speed
            at, _ = force_and_slope(
                (middle - own - 0.5 * b * push - centre) / half_range, parts, low, high)
            second_push = step_rad * (at + middle_push)
            # A push changes the velocity first, so the displacement in the middle is unchanged.
            at, _ = force_and_slope((middle - own - centre) / half_range, parts, low, high)
            third_push = step_rad * (at + middle_push)
            whole, whole_speed = a * own + b * own_speed, c * own + d * own_speed
            at, _ = force_and_slope(
                (end - whole - b * third_push - centre) / half_range, parts, low, high)
            last_push = step_rad * (at + end_push)
            pushes = 2.0 * (second_push + third_push)
            taken = whole + (far * push + b * pushes) / 6.0
            speed = whole_speed + (far_speed * push + d * pushes + last_push) / 6.0
        balanced[n] = loads[n] - taken
    return balanced


def _substeps(phase: float, parts: FloatArray, half_range_um: float, low: float,
              high: float) -> int:
    """Return the substeps of a sample in which the mode alone turns by a phase in rad."""
    visited = np.clip(np.linspace(-VISITED, VISITED, 13), low, high)
    slope = np.polyval(np.arange(4.0, 0.0, -1.0) * parts[::-1], visited) / half_range_um
    stiffest = 1.0 + max(0.0, float(slope.max()))
    return max(1, int(np.ceil(phase * np.sqrt(stiffest) / PHASE_STEP)))


@lru_cache(maxsize=256)
def _half_step(step_rad: float, damping_ratio: float) -> FloatArray:
    """Return the propagation matrix of displacement and velocity for half a step without force."""
    return np.ascontiguousarray(
        expm(0.5 * step_rad * np.array([[0.0, 1.0], [-1.0, -2.0 * damping_ratio]])))


def balance(
    load_um: FloatArray, parts: ArrayLike, viscous: float, centre_um: float, half_range_um: float,
    frequency_rad_per_s: float, damping_ratio: float, sample_period_s: float, rest_um: float,
) -> FloatArray:
    """Solve for the displacement of a mode whose spring has a nonlinear force.

    Solves y = x - G (f(y) + v y'/w): x is the displacement of the linear spring, G the mode with
    unit DC gain. This is the equation of motion y''/w^2 + (2 zeta + v) y'/w + y + f(y) = drive of a
    mode that would reach x without f and v.

    Parameters
    ----------
    load_um : (N,) array
        Displacement x of the linear spring in um.
    parts : (4,) sequence of float
        Force f at the end of the range, as displacement in um, for the powers one to four.
    viscous : float
        Additional damping v.
    centre_um, half_range_um : float
        Centre and half width of the range in um.
    frequency_rad_per_s, damping_ratio : float
        Frequency w and damping ratio zeta; with w = 0, the spring acts at once.
    rest_um : float
        Displacement x before the first sample, in um.

    Returns
    -------
    (N,) array
        Displacement y in um: to rounding accuracy if the spring acts at once; else with an error of
        fourth order in `PHASE_STEP`, and of the interpolation of the load between its samples.
    """
    load_um = np.ascontiguousarray(load_um, dtype=float)
    parts = np.asarray(parts, dtype=float)
    shape = float(centre_um), float(half_range_um), parts, *straight_beyond(parts, half_range_um)
    if frequency_rad_per_s == 0.0:
        return _static(load_um, *shape)
    phase = frequency_rad_per_s * sample_period_s
    substeps = _substeps(phase, parts, half_range_um, *shape[3:])
    step_rad = phase / substeps
    return _swinging(
        load_um, float(rest_um), viscous, *shape,
        _half_step(step_rad, max(0.0, damping_ratio + 0.5 * viscous)), step_rad,
        *_within_sample(substeps))
