# SPDX-License-Identifier: BSD-3-Clause
"""Kernels of a feedback law, compiled without Python objects."""

from numba import njit

from piezo_common.arrays import FloatArray, IntArray
from piezo_models.hysteresis.preisach_inversion import invert
from piezo_models.hysteresis.preisach_kernels import Grid, Table, simulate

# Indices of the sums that `take` updates.
EXPECTED, MEASURED, FADED = 0, 1, 2


@njit(cache=True)
def take(displacement_um: FloatArray, first: int, once_um: FloatArray, period_um: FloatArray,
         begun: int, fade: int, initial_um: float, sums: FloatArray,
         a: FloatArray, b: FloatArray, c: FloatArray, d: float,
         state: FloatArray, work: FloatArray, added_v: float) -> float:
    """Add samples to the sums of their tick; return the next output of the block of samples (V).

    Parameters
    ----------
    displacement_um : ndarray, shape (k,)
        Samples from number `first` of the run on.
    once_um, period_um : ndarray
        Expected displacement in um.
    begun, fade : int
        First sample whose error counts, and the number of samples of the fade.
    initial_um : float
        Initial error in um, which is subtracted and faded out.
    sums : ndarray, shape (3,)
        Sums of the expected, measured and faded displacements; changed in place.
    a, b, c, d, state, work, added_v
        Block at the sample rate as in `advance`, and its last output (V).
    """
    once, period = once_um.size, period_um.size
    for i in range(displacement_um.size):
        sample = first + i
        if sample < once:
            expected = once_um[sample]
        elif period:
            expected = period_um[(sample - once) % period]
        else:
            expected = once_um[once - 1]
        faded = 0.0
        if begun <= sample < begun + fade:
            x = (sample - begun) / fade
            faded = initial_um * (1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x * x))
        sums[EXPECTED] += expected
        sums[MEASURED] += displacement_um[i]
        sums[FADED] += faded
        if state.size or d != 0.0:
            added_v = advance(expected - displacement_um[i] - faded, a, b, c, d, state, work)
    return added_v


@njit(cache=True)
def advance(error: float, a: FloatArray, b: FloatArray, c: FloatArray, d: float,
            state: FloatArray, work: FloatArray) -> float:
    """Return the output (V) of a block for an input (um), and update its state, (n,)."""
    output = d * error
    for i in range(state.size):
        output += c[i] * state[i]
        work[i] = b[i] * error
        for j in range(state.size):
            work[i] += a[i, j] * state[j]
    state[:] = work
    return output


@njit(cache=True)
def decide(error: float, a: FloatArray, b: FloatArray, c: FloatArray, d: float,
           observer: FloatArray, state: FloatArray, work: FloatArray, last_v: float,
           limit_v: float, step_v: float) -> tuple[float, bool]:
    """Return the voltage of the block at the tick's rate within its limits, in V.

    The block has the matrices a, b, c and d, and `error` is the mean error of the tick in um. The
    voltage is at most `limit_v` of either sign, and changes by at most `step_v` from `last_v`. If
    these limits cut it, the observer corrects the state to agree with the limited voltage
    (anti-windup). The state and its work array, (n,), are changed in place. The second result is
    True if the change from `last_v` was limited.
    """
    wanted_v = advance(error, a, b, c, d, state, work)
    voltage_v = min(max(wanted_v, -limit_v), limit_v)
    stepped = abs(voltage_v - last_v) > step_v
    if stepped:
        voltage_v = last_v + (step_v if voltage_v > last_v else -step_v)
    for i in range(state.size):
        state[i] += observer[i] * (voltage_v - wanted_v)
    return voltage_v, stepped


@njit(cache=True)
def through_inverse(wanted_um: float, planned_v: FloatArray, rounding_um: float,
                    range_um: tuple[float, float], range_v: tuple[float, float], held: bool,
                    stacks: FloatArray, tops: IntArray, grid: Grid, table: Table,
                    feedback_v: FloatArray) -> tuple[float, float]:
    """Find the voltages that add a given output of the hysteresis to the planned one.

    Returned are the mean of the added voltages and of what `range_v` cut off (V).

    Parameters
    ----------
    wanted_um : float
        Output to add (um).
    planned_v : ndarray, shape (k,)
        Voltages without the feedback (V).
    range_um, range_v : tuple of float
        Output range of the hysteresis (um), and bounds of the added voltage (V).
    held : bool
        True to add the mean to all samples.
    stacks, tops : ndarray, shape (6, m) and (2,)
        Extremes and outputs of the hysteresis memory: without the feedback, with it, and a work
        copy; with room for 2 k more entries. Top indices of the first two. Changed in place.
    grid, table : tuple
        Arguments of the hysteresis kernels.
    feedback_v : ndarray, shape (k,)
        Filled with the added voltages (V).
    """
    target_um, _, _, top = simulate(planned_v, stacks[0], stacks[1], tops[0], grid, table)
    tops[0] = top
    for i in range(target_um.size):
        target_um[i] = min(max(target_um[i] + wanted_um, range_um[0]), range_um[1])
    used = tops[1] + 1
    stacks[4, :used], stacks[5, :used] = stacks[2, :used], stacks[3, :used]
    inverse_v = invert(target_um, rounding_um, stacks[4], stacks[5], tops[1], grid, table)[0]
    feedback_v[:] = inverse_v - planned_v
    if held:
        feedback_v[:] = feedback_v.mean()
    asked_v = feedback_v.mean()
    for i in range(feedback_v.size):
        feedback_v[i] = min(max(feedback_v[i], range_v[0]), range_v[1])
    tops[1] = simulate(planned_v + feedback_v, stacks[2], stacks[3], tops[1], grid, table)[3]
    mean_v = feedback_v.mean()
    return mean_v, mean_v - asked_v
