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
"""Last step of a search that has found its place: a mark is rounded to a sample in any case."""

FARTHEST = 0.25
"""Part of the time of a line within which a place is sought; half a line later the axes come back,
or pass the next line."""


def lead_samples(position_um: FloatArray, marks: NDArray[np.integer],
                 delay_samples: FloatArray) -> int:
    """Return by how many samples an axis passes a place before its sensor shows it.

    Each axis counts by its squared speed at the marks.

    Parameters
    ----------
    position_um : (N, n) array
        One period of the readings.
    marks : (N,) array
        Bits of `Mark`.
    delay_samples : (n,) array
        By how much the reading of each axis is late.
    """
    speed = np.gradient(position_um, axis=0)[marks > 0] ** 2
    return round(np.sum(speed @ delay_samples) / max(np.sum(speed), np.finfo(float).tiny))


def marks_by_position(position_um: FloatArray, marks: NDArray[np.uint8], reading_um: FloatArray,
                      delay_samples: FloatArray) -> NDArray[np.uint8]:
    """Move the marks of a periodic path to where the axes passed their places.

    A place is passed where the axes cross the plane through it that is at right angles to the path.
    The difference of the readings to the path is averaged over the time of a pixel. A place that is
    not passed within a quarter of a line keeps its mark, as one at which the path rests. Marks stay
    in their order: one that would come before its predecessor follows it by a sample.

    Parameters
    ----------
    position_um : (N, n) array
        One period of the readings that were planned.
    marks : (N,) array of uint8
        Bits of `Mark`, earlier by `lead_samples` than the positions that they mark.
    reading_um : (N, n) array
        Readings of a period that was played with the same voltages.
    delay_samples : (n,) array
        By how much the reading of each axis is late.

    Returns
    -------
    (N,) array of uint8
    """
    samples, marked = len(marks), np.flatnonzero(marks)
    pixels = np.flatnonzero(marks & Mark.PIXEL)
    dwell = max(int(np.median(np.diff(pixels))), 1) if pixels.size > 1 else 1
    moved_um = position_um + uniform_filter1d(reading_um - position_um, dwell, axis=0, mode="wrap")
    lines = max(int(np.sum(marks & Mark.LINE > 0)), 1)
    places = marked + lead_samples(position_um, marks, delay_samples)
    passed = _passed(position_um, places % samples, moved_um, delay_samples)
    passed += places - places % samples
    found = np.abs(passed - marked) < FARTHEST * samples / lines
    at = np.where(found, np.round(np.where(found, passed, 0.0)), marked).astype(int)
    # Two marks within a sample, which noise or a place that was not passed may cause, go to two
    # samples; the last mark stays before the first of the next period.
    number = np.arange(len(at))
    at = np.maximum.accumulate(at - number)
    at = np.minimum(at, at[:1] + samples - len(at)) + number
    by_position = np.zeros_like(marks)
    np.bitwise_or.at(by_position, at % samples, marks[marked])
    return by_position


def _passed(position_um: FloatArray, places: NDArray[np.integer], reading_um: FloatArray,
            delay_samples: FloatArray) -> FloatArray:
    """Return the times in samples at which the axes pass `position_um[places]`; NaN for never."""
    samples = np.arange(len(position_um))
    velocity_um = 0.5 * (np.roll(position_um, -1, axis=0) - np.roll(position_um, 1, axis=0))[places]
    speed = np.maximum(np.sum(velocity_um**2, axis=1), np.finfo(float).tiny)
    times, step = places.astype(float), np.zeros(len(places))
    for _ in range(STEPS):
        there_um = np.column_stack([
            np.interp(times + late, samples, reading, period=len(samples))
            for late, reading in zip(delay_samples, reading_um.T, strict=True)])
        step = np.sum((position_um[places] - there_um) * velocity_um, axis=1) / speed
        times += step
    return np.where(np.abs(step) < CONVERGED_SAMPLES, times, np.nan)
