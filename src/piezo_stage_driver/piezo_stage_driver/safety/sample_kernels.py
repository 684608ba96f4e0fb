# SPDX-License-Identifier: BSD-3-Clause
"""Compiled operations on every sample of a tick, for which NumPy would take longer."""

import math

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray

FLAG_RANGE_LIMITED = 1
FLAG_SLEW_LIMITED = 2


@njit(cache=True)
def hold_within(wanted_v: FloatArray, previous_v: float, minimum_v: float, maximum_v: float,
                step_v: float) -> tuple[FloatArray, int]:
    """Hold voltages within a range and a slew, the largest change from sample to sample.

    NaN is replaced by the voltage before it. Returned are the voltages, (n,), and the flags.
    """
    limited_v = np.empty(wanted_v.size)
    flags, number_v, last_v, steep = 0, previous_v, previous_v, False
    for i in range(wanted_v.size):
        if not math.isnan(wanted_v[i]):
            number_v = wanted_v[i]
        value_v = min(max(number_v, minimum_v), maximum_v)
        if value_v != wanted_v[i]:
            flags = FLAG_RANGE_LIMITED
        steep |= abs(value_v - last_v) > step_v
        limited_v[i] = last_v = value_v
    if steep:
        flags |= FLAG_SLEW_LIMITED
        last_v = previous_v
        for i in range(limited_v.size):
            last_v += min(max(limited_v[i] - last_v, -step_v), step_v)
            limited_v[i] = last_v
    return limited_v, flags


@njit(cache=True)
def extremes(values: FloatArray) -> tuple[float, float]:
    """Return the lowest and the highest of values, shape (n,); both NaN if one value is."""
    lowest = highest = values[0]
    for value in values:
        if math.isnan(value):
            return math.nan, math.nan
        lowest, highest = min(lowest, value), max(highest, value)
    return lowest, highest


@njit(cache=True)
def tick_means(values: FloatArray, samples_per_tick: int) -> FloatArray:
    """Return the mean over each tick of values, shape (ticks * samples_per_tick,)."""
    means = np.empty(values.size // samples_per_tick)
    for tick in range(means.size):
        total = 0.0
        for i in range(samples_per_tick):
            total += values[tick * samples_per_tick + i]
        means[tick] = total / samples_per_tick
    return means


@njit(cache=True)
def fourth_difference(values: FloatArray) -> float:
    """Return the mean magnitude of the fourth differences of at least five values, shape (n,)."""
    total = 0.0
    for i in range(values.size - 4):
        total += abs(values[i] - 4.0 * values[i + 1] + 6.0 * values[i + 2] - 4.0 * values[i + 3]
                     + values[i + 4])
    return total / (values.size - 4)


def columns(samples: FloatArray) -> list[FloatArray]:
    """Return contiguous samples of each axis, shape (n,), as the kernels require."""
    return [samples] if samples.ndim == 1 else list(np.ascontiguousarray(samples.T))


def compile_kernels() -> None:
    """Compile all kernels, so that no tick has to wait for it."""
    values = np.zeros(5)
    hold_within(values, 0.0, 0.0, 0.0, 0.0)
    extremes(values)
    tick_means(values, 1)
    fourth_difference(values)
