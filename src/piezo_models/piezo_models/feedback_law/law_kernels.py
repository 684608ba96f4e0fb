# SPDX-License-Identifier: BSD-3-Clause
"""Kernels of a feedback law: nothing in them asks Python for anything."""

from numba import njit

from piezo_common.arrays import FloatArray, IntArray
from piezo_models.hysteresis.preisach_inversion import invert
from piezo_models.hysteresis.preisach_kernels import Grid, Table, simulate

# Of the sums that `take` keeps.
EXPECTED, MEASURED, FADED = 0, 1, 2


@njit(cache=True)
def take(displacement_um: FloatArray, first: int, once_um: FloatArray, period_um: FloatArray,
         begun: int, fade: int, initial_um: float, sums: FloatArray,
         a: FloatArray, b: FloatArray, c: FloatArray, d: float,
         state: FloatArray, work: FloatArray, added_v: float) -> float:
    """Add samples to the sums of their tick, and advance the block at the sample rate.

    Parameters
    ----------
    displacement_um : ndarray, shape (k,)
    first : int
        Number of the first of them in the run.
    once_um, period_um : ndarray
        Expected.
    begun, fade : int
        The sample from which on the error counts, and how many after it until all of it does.
    initial_um : float
        Error in which the law began, faded out of what it sees.
    sums : ndarray, shape (3,)
        Of what is expected, measured, and faded out; changed in place.
    a, b, c, d
        Of the block at the sample rate.
    state, work : ndarray, shape (m,)
        Of that block, and room for it; changed in place.
    added_v : float
        What it gave last (V).

    Returns
    -------
    float
        What it gives for the sample that follows (V).
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
    """Return the output of a block for an input, and go on to its next state.

    Parameters
    ----------
    error : float
        The input (um).
    a, b, c, d
        Of the block.
    state, work : ndarray, shape (n,)
        Changed in place.

    Returns
    -------
    float
        In V.
    """
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
    """Return the voltage of the block at the tick's rate within its limits.

    Where they cut the voltage, the observer keeps the state in agreement with what is given.

    Parameters
    ----------
    error : float
        Mean of the tick (um).
    a, b, c, d, observer
        Of the block, and what corrects its state.
    state, work : ndarray, shape (n,)
        Changed in place.
    last_v, limit_v, step_v : float
        The voltage before, the largest of either sign, and the largest change (V).

    Returns
    -------
    voltage_v : float
    stepped : bool
        Whether it was asked to change by more than `step_v` from `last_v`.
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
    """Find the voltages that add an output of the hysteresis to that of what is planned.

    Parameters
    ----------
    wanted_um : float
        To be added.
    planned_v : ndarray, shape (k,)
        Without the feedback.
    range_um : tuple of float
        Of the hysteresis' output.
    range_v : tuple of float
        Of what may be added.
    held : bool
        Whether the mean of these is added to all samples.
    stacks : ndarray, shape (6, m)
        Extremes and outputs that the hysteresis remembers without the feedback, with it, and room
        for a trial; with room for 2 k entries more. Changed in place.
    tops : ndarray of int, shape (2,)
        Of the first two.
    grid, table : tuple
        Of the hysteresis.
    feedback_v : ndarray, shape (k,)
        To be filled with what is added (V).

    Returns
    -------
    mean_v : float
        Of what is added.
    lacking_v : float
        Mean of what `range_v` cut off.
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
