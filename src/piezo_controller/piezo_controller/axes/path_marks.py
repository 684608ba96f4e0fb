# SPDX-License-Identifier: BSD-3-Clause
"""When to mark the places of a path, as sensors show them late and axes do not quite follow it."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from piezo_common.arrays import FloatArray
from piezo_recorder.sample_block import Mark

STEPS = 12
"""Number of steps of a search for the time of a place. Where the speed is within 40 % of the
planned one, the last step is below 1/10000 of the first."""

CONVERGED_SAMPLES = 0.1
"""Largest last step of a search that has found its place: that of a mark, where noise is as large
as the motion in a sample."""

FARTHEST = 0.25
"""Part of the time of a line within which a place is sought; half a line later the axes come back,
or pass the next line."""


def lead_samples(position_um: FloatArray, marks: NDArray[np.integer],
                 delay_samples: FloatArray) -> int:
    """Return by how many samples an axis passes a place before its sensor shows it.

    The readings of one period, (N, n), have marks, (N,), and are late by a delay of each axis,
    (n,). Each axis counts by its squared speed at the marks.
    """
    speed = np.gradient(position_um, axis=0)[marks > 0] ** 2
    return round(np.sum(speed @ delay_samples) / max(np.sum(speed), np.finfo(float).tiny))


def marks_by_position(position_um: FloatArray, marks: NDArray[np.uint8], reading_um: FloatArray,
                      delay_samples: FloatArray) -> NDArray[np.uint8]:
    """Move the marks of a periodic path to where the axes passed their places, (N,).

    A place is passed where the axes come closest to it, across the direction in which the path
    leads at that time. The difference of the readings to the path is averaged, over the time of a
    pixel at most. A place that is not passed within a quarter of a line keeps its mark, as one at
    which the path rests. Marks stay in their order: one that would come before its predecessor
    follows it by a sample.

    One period of the readings that were planned, (N, n), is compared with the readings, (N, n), of
    a period that was played with the same voltages. The marks are bits of `Mark`, and earlier by
    `lead_samples` than the positions that they mark. The reading of each axis is late by
    `delay_samples`, (n,).
    """
    samples, marked = len(marks), np.flatnonzero(marks)
    pixels = np.flatnonzero(marks & Mark.PIXEL)
    dwell = max(int(np.median(np.diff(pixels))), 1) if pixels.size > 1 else 1
    line = samples / max(int(np.sum(marks & Mark.LINE > 0)), 1)
    moved_um = position_um + np.column_stack([
        _averaged(off_um, dwell, line) for off_um in (reading_um - position_um).T])
    places = marked + lead_samples(position_um, marks, delay_samples)
    passed = _passed(position_um, places % samples, moved_um, delay_samples)
    passed += places - places % samples
    found = np.abs(passed - marked) < FARTHEST * line
    at = np.where(found, np.round(np.where(found, passed, 0.0)), marked).astype(int)
    # Two marks within a sample, which noise or a place that was not passed may cause, go to two
    # samples; the last mark stays before the first of the next period.
    number = np.arange(len(at))
    at = np.maximum.accumulate(at - number)
    at = np.minimum(at, at[:1] + samples - len(at)) + number
    by_position = np.zeros_like(marks)
    np.bitwise_or.at(by_position, at % samples, marks[marked])
    return by_position


def _averaged(off_um: FloatArray, longest: int, line: float) -> FloatArray:
    """Return a noisy signal averaged over `longest` samples, a half, a quarter and so on of them.

    The longer the average, the less noise it has, and the less of a vibration it follows. At each
    sample the one counts whose squared error over the time of a line is the smallest, by Stein's
    unbiased estimate (1981) for white noise.
    """
    variance = np.mean(np.diff(off_um, 2) ** 2) / 6.0
    best_um, least = off_um, np.full(len(off_um), np.inf)
    for length in longest // 2 ** np.arange(longest.bit_length()):
        average_um = uniform_filter1d(off_um, length, mode="nearest")
        error = uniform_filter1d((average_um - off_um) ** 2, round(line), mode="nearest")
        error += 2.0 * variance / length
        best_um, least = np.where(error < least, average_um, best_um), np.minimum(error, least)
    return best_um


def _passed(position_um: FloatArray, places: NDArray[np.integer], reading_um: FloatArray,
            delay_samples: FloatArray) -> FloatArray:
    """Return the times in samples at which the axes pass `position_um[places]`; NaN for never."""
    samples = np.arange(len(position_um))
    velocity_um = 0.5 * (np.roll(position_um, -1, axis=0) - np.roll(position_um, 1, axis=0))
    times, step = places.astype(float), np.zeros(len(places))

    def at(signal: FloatArray, late: FloatArray) -> FloatArray:
        return np.column_stack([
            np.interp(times + each, samples, column, period=len(samples))
            for each, column in zip(late, signal.T, strict=True)])

    for _ in range(STEPS):
        there_um, way_um = at(reading_um, delay_samples), at(velocity_um, 0.0 * delay_samples)
        speed = np.maximum(np.sum(way_um**2, axis=1), np.finfo(float).tiny)
        step = np.sum((position_um[places] - there_um) * way_um, axis=1) / speed
        times += step
    return np.where(np.abs(step) < CONVERGED_SAMPLES, times, np.nan)
