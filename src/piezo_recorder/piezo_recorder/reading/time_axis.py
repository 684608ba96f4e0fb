# SPDX-License-Identifier: BSD-3-Clause
"""Samples of one period from the times of rows: jitter, rounding, lost rows and gaps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_recorder.reading.recording import RecordingError


@dataclass(frozen=True)
class TimeSettings:
    """Thresholds for the interpretation of the times of rows."""

    uniform: float = 0.1
    """Part of a period: rows with a smaller deviation count as samples at their instants. In a ramp
    the error is this part of the step from sample to sample."""
    gap_periods: float = 3.0
    """A longer distance between rows is a gap; a shorter one is interpolated linearly."""
    longest_gap: float = 1e10
    """Distance in periods above which a time is invalid rather than a gap."""
    even: float = 0.1
    """Part of a period: if the spread of the distances is smaller, a distance of two periods is a
    lost row; at this spread 1.5 periods are five standard deviations away."""
    most_gaps: float = 0.05
    """Part of the rows that may end at a gap; with more there is no period."""
    restart: float = 0.05
    """Part of a recording's duration: if the time falls to this part, it starts again."""
    most_repeated: float = 0.05
    """Part of the rows that may repeat the row above by a fault of the logger."""
    most_ticks: int = 12
    """Largest number of different distances, in ticks, for which times count as rounded to
    ticks."""


SAME_ROW = 1e-6
"""Part of a row by which arithmetic may take an instant away from the row that it is that of."""

SETTINGS = TimeSettings()


@dataclass(frozen=True)
class TimeAxis:
    """The samples that correspond to the rows."""

    period_s: float

    sample_index: np.ndarray
    """Index of each sample on a clock of this period, (N,)."""
    at_rows: FloatArray | None = None
    """Position of each sample among the rows, e.g. 2.5 half-way between rows 2 and 3, (N,); None if
    the rows are the samples."""
    jitter_s: float = 0.0
    """Standard deviation of the times of the rows from a clock of this period."""
    notes: list[str] = field(default_factory=list)
    """What was done, for users, without the name of the file."""


def first_decrease(time_s: FloatArray) -> int | None:
    """Return the first row whose time is before that of the row above, or None."""
    falls = np.flatnonzero(np.diff(time_s) < 0.0)
    return int(falls[0]) + 1 if falls.size else None


def restarts(time_s: FloatArray) -> list[int]:
    """Return the rows at which the time starts again near its first value.

    There is none if the time also decreases in another way.
    """
    rows = (np.flatnonzero(np.diff(time_s) < 0.0) + 1).tolist()
    for begin, row in zip([0, *rows], rows, strict=False):
        first_s, last_s = time_s[begin], time_s[row - 1]
        if time_s[row] - first_s > SETTINGS.restart * (last_s - first_s):
            return []
    return rows


def repeated_rows(time_s: FloatArray, signals: Sequence[FloatArray]) -> NDArray[np.bool_]:
    """Mark the rows, (N,), that a logger wrote twice: they equal the row above in all numbers.

    No row is marked if the time repeats in many rows: its clock is rounded, or does not run.
    """
    stands = np.diff(time_s, prepend=-np.inf) == 0.0
    if np.mean(stands) > SETTINGS.most_repeated:
        return np.zeros(time_s.size, dtype=bool)
    for values in signals:
        stands &= np.diff(values, prepend=np.nan) == 0.0
    return stands


def time_axis(time_s: FloatArray, place: Callable[[int], str], label: str) -> TimeAxis:
    """Determine the period of at least two rows whose times do not decrease.

    RecordingError is raised if the time does not advance, decreases, or has no period.
    """
    count = time_s.size
    steps_s = np.diff(time_s)
    row = first_decrease(time_s)
    if row is not None:
        usual_s = float(np.median(steps_s))
        raise RecordingError(
            f"{place(row)}: {label} steps by {steps_s[row - 1]:g} s where {usual_s:g} s is usual: "
            "sort the rows, or number the recordings of one file in a column "
            "(--columns recording=NAME)")
    if time_s[-1] <= time_s[0]:
        raise RecordingError(f"{place(1)}: {label} steps by 0 s in every row: give the time of "
                             "each row, or --columns rate=NUMBER[Hz] without a time")
    period_s = float(time_s[-1] - time_s[0]) / (count - 1)
    off_s = time_s - time_s[0] - period_s * np.arange(count)
    if np.abs(off_s).max() <= SETTINGS.uniform * period_s:
        return TimeAxis(period_s, np.arange(count), jitter_s=float(np.std(off_s)))
    return _uneven(time_s, steps_s, place, label)


def _uneven(time_s: FloatArray, steps_s: FloatArray, place: Callable[[int], str],
            label: str) -> TimeAxis:
    """Determine the period of rows that are not equally spaced throughout."""
    typical_s = float(np.median(steps_s[steps_s > 0.0]))
    limit_s = SETTINGS.gap_periods * typical_s
    inside = steps_s <= limit_s
    gaps = np.flatnonzero(~inside)
    if steps_s.max() > SETTINGS.longest_gap * typical_s:
        worst = int(np.argmax(steps_s))
        raise RecordingError(f"{place(worst + 1)}: {label} steps by {steps_s[worst]:g} s where "
                             f"{typical_s:g} s is usual: mend the time there")
    if gaps.size > max(SETTINGS.most_gaps * time_s.size, 10):
        raise RecordingError(
            f"{place(int(gaps[0]) + 1)}: {label} has no sample period, its steps go from "
            f"{steps_s.min():g} to {steps_s.max():g} s: record at one rate")
    core_s = steps_s[inside]
    period_s, lost = _period(core_s, typical_s)
    counts = np.ones(steps_s.size, dtype=np.int64)
    counts[inside] += lost
    ticks = _row_ticks(time_s, counts, gaps, period_s)
    period_s = _fitted_period_s(time_s, ticks, gaps) or period_s
    ticks = _row_ticks(time_s, counts, gaps, period_s)
    off_s = _off_s(time_s - time_s[0] - period_s * ticks, gaps)
    tick_s = _rounding_s(core_s, typical_s)
    notes = _gap_notes(gaps, steps_s, place)
    largest_s = float(np.abs(off_s).max())
    jitter_s = float(np.std(off_s))
    if largest_s <= SETTINGS.uniform * period_s and not lost.any():
        return TimeAxis(period_s, ticks, None, jitter_s, notes)
    if tick_s and not lost.any() and largest_s <= tick_s:
        notes.append(f"the time is rounded to {tick_s:g} s: the rows are taken as even, "
                     f"{period_s:g} s apart")
        return TimeAxis(period_s, ticks, None, jitter_s, notes)
    if lost.any():
        notes.append(f"{int(lost.sum())} rows are missing one by one and were put in by straight "
                     "lines")
    if largest_s > SETTINGS.uniform * period_s:
        notes.append(f"the rows lie up to {largest_s:.3g} s off an even clock of {period_s:.6g} s "
                     f"({100.0 * largest_s / period_s:.3g} % of the period; "
                     f"{100.0 * SETTINGS.uniform:g} % are taken as they are): they were resampled "
                     "by straight lines")
        index, at_rows = _grid((time_s - time_s[0]) / period_s, gaps)
    else:
        index, at_rows = _grid(ticks.astype(float), gaps)
    return TimeAxis(period_s, index, at_rows, jitter_s, notes)


def _period(core_s: FloatArray, typical_s: float) -> tuple[float, np.ndarray]:
    """Return the period of rows without gaps, and the number of lost rows in each step."""
    lost = np.maximum(np.round(core_s / typical_s).astype(np.int64) - 1, 0)
    even = np.std(core_s - typical_s * (1 + lost)) < SETTINGS.even * typical_s
    if not even or np.mean(lost > 0) > SETTINGS.even:
        lost[:] = 0
    return float(core_s.sum() / (core_s.size + lost.sum())), lost


def _row_ticks(time_s: FloatArray, counts: np.ndarray, gaps: np.ndarray,
               period_s: float) -> np.ndarray:
    """Return the position of each row on the clock; gaps are rounded to whole periods."""
    steps = counts.copy()
    for gap in gaps.tolist():
        steps[gap] = max(round((time_s[gap + 1] - time_s[gap]) / period_s), 1)
    return np.concatenate([[0], np.cumsum(steps)])


def _fitted_period_s(time_s: FloatArray, ticks: np.ndarray, gaps: np.ndarray) -> float:
    """Return the period by least squares over all segments; 0 if each is a single row."""
    product = square = 0.0
    for time, tick in zip(np.split(time_s, gaps + 1), np.split(ticks, gaps + 1), strict=True):
        from_mean = tick - tick.mean()
        product += float(from_mean @ (time - time[0]))
        square += float(from_mean @ from_mean)
    return product / square if square > 0.0 else 0.0


def _off_s(off_s: FloatArray, gaps: np.ndarray) -> FloatArray:
    """Return the deviations of rows from the clock, less the median of each of several segments."""
    parts = np.split(off_s, gaps + 1)
    return np.concatenate([part - np.median(part) if len(parts) > 1 else part for part in parts])


def _rounding_s(core_s: FloatArray, typical_s: float) -> float:
    """Return the tick of a clock that rounds the times; 0 if they are not rounded."""
    distances = np.unique(np.round(core_s / typical_s, 4))
    if not 1 < distances.size <= SETTINGS.most_ticks:
        return 0.0
    tick = float(np.diff(distances).min())
    whole = distances / tick
    return tick * typical_s if np.abs(whole - np.round(whole)).max() < 0.02 else 0.0


def _gap_notes(gaps: np.ndarray, steps_s: FloatArray, place: Callable[[int], str]) -> list[str]:
    if not gaps.size:
        return []
    first = int(gaps[0])
    where = place(first + 1).rpartition(", ")[2]
    return [f"the time has {gaps.size} gap{'s' if gaps.size > 1 else ''}, the first of "
            f"{steps_s[first]:.4g} s before {where}: there are {gaps.size + 1} segments"]


def _grid(tick: FloatArray, gaps: np.ndarray) -> tuple[np.ndarray, FloatArray]:
    """Return the samples of an even clock in each segment, and their positions among the rows.

    The ticks are the times of the rows in periods of the clock, (N,).
    """
    edges = [0, *(gaps + 1).tolist(), tick.size]
    indices, places = [], []
    for start, end in zip(edges[:-1], edges[1:], strict=True):
        of_rows = tick[start:end]
        index = np.arange(
            np.ceil(of_rows[0] - 1e-9), np.floor(of_rows[-1] + 1e-9) + 1, dtype=np.int64)
        indices.append(index)
        places.append(np.interp(index, of_rows, np.arange(start, end, dtype=float)))
    place = np.concatenate(places)
    row = np.round(place)
    # A row that is there keeps its values to the last digit, in which a converter's steps show.
    return np.concatenate(indices), np.where(np.abs(place - row) < SAME_ROW, row, place)
