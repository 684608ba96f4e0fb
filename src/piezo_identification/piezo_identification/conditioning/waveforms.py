# SPDX-License-Identifier: BSD-3-Clause
"""Properties of the voltage of a recording that the estimators need before fitting."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_recorder.reading.recording import Recording


@dataclass(frozen=True)
class WaveformSettings:
    """Settings for the classification of voltages."""

    level_tolerance: float = 0.01
    """Largest deviation of a square wave from its two levels, as a fraction of the swing; it allows
    noise and resolution of the converter."""
    slow_branch_s: float = 0.05
    """A branch between two reversals that takes longer shows hysteresis, a shorter one dynamics.
    The slowest modes and lags of a stage decay in this time."""
    held_time: float = 0.01
    """Time of a hold, as a fraction of the duration: within it the voltage stays within the
    tolerance of a level."""
    held_rows: float = 0.3
    """Smallest part of the rows in holds of a recording with holds."""
    smallest_reversal: float = 1e-3
    """Smallest reversal that is not noise, as a fraction of the voltage range, where branches are
    classified by their duration."""


SETTINGS = WaveformSettings()

REVERSAL = 0.02
"""Smallest reversal between two branches, as a fraction of the voltage range."""

JUMP_SHARE = 0.02
"""Change within a sample, relative to the voltage range, that counts as a jump."""

SAMPLES_WHILE_FAST = 10.0
"""Fewest samples in `WaveformSettings.slow_branch_s`, in which the fast dynamics settle."""

SLOWEST_FAST_ROWS_S = SETTINGS.slow_branch_s / SAMPLES_WHILE_FAST
"""Longest sample period (s) that shows dynamics; beyond it, ringing is aliased."""

FEWEST_LEVEL_STEPS = 2
"""Fewest steps between two levels that form a square wave within other voltages; fewer steps never
return to a level."""

FEWEST_PERIODS = 4
"""Fewest periods for which the later half shows how much settled periods differ."""

UNLIKE = 1.1
"""A period has not settled if the power of its difference from the later ones exceeds the largest
of theirs by this factor. Smaller differences are a small part of the noise of the mean period."""


def played(recording: Recording) -> Recording:
    """Return the part of a recording in which a waveform or trajectory is played, without ramps.

    Raise ValueError if nothing is played, or samples are missing.
    """
    part = recording.select(recording.playing | recording.tracking)
    if part.gaps:
        first, count = part.gaps[0]
        raise ValueError(
            f"{recording.path} has a gap of {count} samples at sample {first}: the hysteresis "
            "depends on every voltage, record it again"
        )
    return part


def with_voltage_before(recording: Recording, part: Recording) -> tuple[FloatArray, int]:
    """Return the voltage of a part of a recording, preceded by the voltage before it.

    The hysteresis depends on the voltage before the part, too. Also return the number of samples
    before the part.
    """
    before = np.asarray(recording.voltage_v)[recording.sample_index < part.sample_index[0]]
    return np.concatenate([before, part.voltage_v]).astype(float), before.size


def samples_per_mean(recording: Recording) -> int:
    """Return the number of clock samples averaged in each displacement; 1 without averaging."""
    return max(1, round(recording.sample_period_s * recording.sample_rate_hz))


@dataclass(frozen=True)
class SquareWave:
    """A voltage that takes two levels."""

    level: FloatArray
    """0 at the lower voltage, 1 at the upper one, (N,)."""
    steps: NDArray[np.intp]
    """Samples at which the level changes, one at least."""


def two_levels(recording: Recording) -> SquareWave | None:
    """Return the voltage of a recording as a square wave; None if it does not have two levels."""
    voltage_v = recording.voltage_v
    low_v, high_v = voltage_v.min(), voltage_v.max()
    swing_v = high_v - low_v
    level = (voltage_v > 0.5 * (low_v + high_v)).astype(float)
    off_v = np.abs(voltage_v - low_v - swing_v * level).max()
    if swing_v == 0.0 or off_v > SETTINGS.level_tolerance * swing_v:
        return None
    return SquareWave(level, np.flatnonzero(np.diff(level)) + 1)


def square_part(recording: Recording) -> Recording:
    """Remove rests and ramps before and after a square wave between two levels.

    The hysteresis under a square wave is periodic from the first step on at the latest: the step to
    the second level closes the loop, whatever the past. Before it, the state is unknown.

    The levels are those of the middle half of the recording. The whole recording is returned if
    that half does not have two levels, or the voltage never returns to one of them.
    """
    voltage_v = recording.voltage_v
    middle = slice(voltage_v.size // 4, voltage_v.size - voltage_v.size // 4)
    low_v, high_v = voltage_v[middle].min(), voltage_v[middle].max()
    off_v = np.minimum(np.abs(voltage_v - low_v), np.abs(voltage_v - high_v))
    off = np.flatnonzero(off_v > SETTINGS.level_tolerance * (high_v - low_v))
    if off.size == 0 or low_v == high_v:
        return recording
    half = voltage_v.size // 2
    before, after = off[off < half], off[off >= half]
    begin = before[-1] + 1 if before.size else 0
    end = after[0] if after.size else voltage_v.size
    is_high = voltage_v[begin:end] > 0.5 * (low_v + high_v)
    if end - begin < half or np.count_nonzero(np.diff(is_high)) < FEWEST_LEVEL_STEPS:
        return recording
    # A slow ramp stays near its level for a while.
    at_level = begin + np.flatnonzero(off_v[begin:end] <= off_v[middle].max())
    kept = np.zeros(voltage_v.size, dtype=bool)
    kept[at_level[0] : at_level[-1] + 1] = True
    return recording.select(kept)


def jumps_of(voltage_v: FloatArray, range_v: float | None = None) -> NDArray[np.intp]:
    """Return the first sample of each jump; its size is relative to a range, by default theirs."""
    change_v = np.abs(np.diff(voltage_v, prepend=voltage_v[0]))
    return np.flatnonzero(
        change_v > JUMP_SHARE * (np.ptp(voltage_v) if range_v is None else range_v))


def longest_run(voltage_v: FloatArray) -> int:
    """Return the largest number of samples between two jumps, or between one and an end."""
    return int(np.diff(np.concatenate([[0], jumps_of(voltage_v), [voltage_v.size]])).max())


def has_holds(recording: Recording) -> bool:
    """Return whether the voltage stands for much of a recording, in which creep alone moves."""
    voltage_v = np.asarray(recording.voltage_v, dtype=float)
    rows = max(1, round(SETTINGS.held_time * voltage_v.size))
    change_v = np.abs(voltage_v[rows:] - voltage_v[:-rows])
    return bool(np.mean(change_v <= SETTINGS.level_tolerance * np.ptp(voltage_v))
                >= SETTINGS.held_rows)


def square_wave(recording: Recording) -> SquareWave:
    """Return the voltage of a recording as a square wave.

    Raise ValueError if the voltage takes other values than two levels, or never changes.
    """
    wave = two_levels(recording)
    if wave is None:
        raise ValueError(
            f"{recording.path} is no square wave between two voltages: "
            "give the recording of a creep or dynamics experiment"
        )
    return wave


def first_settled_step(signal: FloatArray, steps: NDArray[np.intp], earliest: int) -> int:
    """Find the first step of a square wave from which all periods are equal, by its number.

    A mode that rings for long, or a loop that is not closed yet, makes the first periods differ
    from the later ones by more than these differ from each other. Offset and slope of each period
    are attributed to creep and ignored.

    The signal, (N,), is the measured displacement, `steps` are the samples at which the wave
    changes its level, and `earliest` is the earliest sample of the step. At most the first half of
    the periods is excluded. If there are few periods, or the wave is not periodic, it is the first
    step from the earliest sample on.
    """
    first = int(np.searchsorted(steps, earliest))
    kept = steps[first:]
    if kept.size < 3 or np.any(kept[2:] - kept[:-2] != kept[2] - kept[0]):
        return first
    length = int(kept[2] - kept[0])
    count = int(kept[-1] - kept[0]) // length
    if count < FEWEST_PERIODS:
        return first
    periods = signal[kept[0] : kept[0] + count * length].reshape(count, length)
    half = count // 2
    off = periods - periods[half:].mean(axis=0)
    slow = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, length), 2))[0]
    powers = np.sum((off - (off @ slow) @ slow.T) ** 2, axis=1)
    later = count - half
    # A later period is nearer to the mean, of which it is a part, than an early one.
    largest = UNLIKE * powers[half:].max() * (later + 1) / (later - 1)
    alike = np.flatnonzero(powers[:half] <= largest)
    return first + 2 * int(alike[0] if alike.size else half)


def turning_points(voltage_v: FloatArray, threshold_v: float) -> NDArray[np.intp]:
    """Find the samples at which the voltage reverses, including the first and last sample.

    Only a change back of more than the threshold is a reversal.
    """
    return np.flatnonzero(_turns(np.ascontiguousarray(voltage_v, dtype=float), threshold_v))


def turns_inside(voltages_v: Sequence[FloatArray]) -> bool:
    """Return whether a voltage also reverses elsewhere than at the ends of the range of all."""
    low_v, high_v = min(map(np.min, voltages_v)), max(map(np.max, voltages_v))
    near_v = SETTINGS.level_tolerance * (high_v - low_v)
    turns_v = np.concatenate([voltage_v[turning_points(voltage_v, near_v)[1:-1]]
                              for voltage_v in voltages_v])
    return bool(np.any((turns_v > low_v + near_v) & (turns_v < high_v - near_v)))


@njit(cache=True, nogil=True)
def _turns(voltage_v: FloatArray, threshold_v: float) -> NDArray[np.bool_]:
    """Mark the points of `turning_points`."""
    turns = np.zeros(voltage_v.size, dtype=np.bool_)
    turns[0] = turns[-1] = True
    extreme, direction = 0, 0.0
    for sample in range(1, voltage_v.size):
        if voltage_v[sample] == voltage_v[sample - 1]:
            continue
        travel_v = voltage_v[sample] - voltage_v[extreme]
        if direction * travel_v >= 0.0 and (direction != 0.0 or abs(travel_v) > threshold_v):
            extreme = sample
            if direction == 0.0:
                direction = np.sign(travel_v)
        elif direction != 0.0 and abs(travel_v) > threshold_v:
            turns[extreme] = True
            extreme, direction = sample, -direction
    turns[extreme] = True
    return turns


def slow_branches(time_s: FloatArray, voltage_v: FloatArray) -> NDArray[np.bool_]:
    """Mark the samples of branches that take longer than `SETTINGS.slow_branch_s`, (N,)."""
    points = turning_points(voltage_v, SETTINGS.smallest_reversal * float(np.ptp(voltage_v)))
    slow = np.zeros(voltage_v.size, dtype=bool)
    for start, end in zip(points[:-1], points[1:], strict=True):
        slow[start : end + 1] = time_s[end] - time_s[start] > SETTINGS.slow_branch_s
    return slow
