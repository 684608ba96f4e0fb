# SPDX-License-Identifier: BSD-3-Clause
"""The state in which a recording begins: at rest, or not yet in its periodic state.

The hysteresis of a stage under a square wave is periodic from the first step on at the latest: the
step to the second level closes the loop, whatever the past. Before it, the state is unknown.
"""

from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.waveforms import SETTINGS as WAVEFORM
from piezo_recorder.reading.recording import Recording


@dataclass(frozen=True)
class StartSettings:
    """Settings for the start of a recording."""

    significant: float = 5.0
    """Standard deviations above which a change of the displacement at the start is motion."""
    first_samples: int = 200
    fewest_samples: int = 8
    """Most and fewest samples at the start, while the voltage rests, from which motion is
    estimated."""
    least_motion: float = 1e-3
    """Fraction of the displacement's span below which motion at the start is negligible."""
    fewest_steps: int = 2
    """Fewest steps between two levels that form a square wave within other voltages; fewer steps
    never return to a level."""


SETTINGS = StartSettings()


def square_part(recording: Recording) -> Recording:
    """Remove rests and ramps before and after a square wave between two levels.

    Parameters
    ----------
    recording : Recording
        Recording; the levels are those of its middle half.

    Returns
    -------
    Recording
        The part in which the voltage takes only two values; the whole recording if the middle half
        does not have two levels, or the voltage never returns to one of them.
    """
    voltage_v = recording.voltage_v
    middle = slice(voltage_v.size // 4, voltage_v.size - voltage_v.size // 4)
    low_v, high_v = voltage_v[middle].min(), voltage_v[middle].max()
    off_v = np.minimum(np.abs(voltage_v - low_v), np.abs(voltage_v - high_v))
    off = np.flatnonzero(off_v > WAVEFORM.level_tolerance * (high_v - low_v))
    if off.size == 0 or low_v == high_v:
        return recording
    half = voltage_v.size // 2
    before, after = off[off < half], off[off >= half]
    begin = before[-1] + 1 if before.size else 0
    end = after[0] if after.size else voltage_v.size
    is_high = voltage_v[begin:end] > 0.5 * (low_v + high_v)
    if end - begin < half or np.count_nonzero(np.diff(is_high)) < SETTINGS.fewest_steps:
        return recording
    # A slow ramp stays near its level for a while.
    at_level = begin + np.flatnonzero(off_v[begin:end] <= off_v[middle].max())
    kept = np.zeros(voltage_v.size, dtype=bool)
    kept[at_level[0] : at_level[-1] + 1] = True
    return recording.select(kept)


def first_run_length(voltage_v: FloatArray) -> int:
    """Count the samples until the voltage first changes; all samples if it never does.

    Parameters
    ----------
    voltage_v : ndarray, shape (N,)
    """
    slack_v = WAVEFORM.level_tolerance * float(np.ptp(voltage_v))
    moved = np.flatnonzero(np.abs(voltage_v - voltage_v[0]) > slack_v)
    return int(moved[0]) if moved.size else voltage_v.size


def without_first(recording: Recording, samples: int) -> Recording:
    """Return the recording without its first samples."""
    return recording.select(np.arange(recording.voltage_v.size) >= samples)


def motion_um_per_s(recording: Recording) -> float:
    """Return the velocity at the start of a recording while its voltage rests.

    Returns
    -------
    float
        Velocity in um/s; 0 if the voltage moves at once, or the change is within the noise.
    """
    count = min(first_run_length(recording.voltage_v), SETTINGS.first_samples)
    if count < SETTINGS.fewest_samples:
        return 0.0
    time_s = recording.time_s[:count] - recording.time_s[:count].mean()
    slope = _significant_slope(time_s, recording.displacement_um[:count])
    moved_um = abs(slope) * 2.0 * time_s[-1]
    least_um = SETTINGS.least_motion * float(np.ptp(recording.displacement_um))
    # A slow ramp stays near its first voltage for a while, and moves the stage.
    is_driven = _significant_slope(time_s, recording.voltage_v[:count]) != 0.0
    return slope if moved_um > least_um and not is_driven else 0.0


def _significant_slope(time_s: FloatArray, values: FloatArray) -> float:
    """Return the slope of values over centred times; 0 if it is within their noise."""
    # Relative to the first value, so that a resting voltage has no slope by rounding.
    slope = float(time_s @ (values - values[0]) / (time_s @ time_s))
    # Differences of neighbours give the noise even if the values move along a curve.
    noise = float(np.std(np.diff(values)) / np.sqrt(2.0))
    return slope if abs(slope) > SETTINGS.significant * noise / np.sqrt(time_s @ time_s) else 0.0
