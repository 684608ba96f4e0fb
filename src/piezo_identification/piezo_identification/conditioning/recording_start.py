# SPDX-License-Identifier: BSD-3-Clause
"""The part of a recording in which its voltage is a square wave.

The hysteresis of a stage under a square wave is periodic from the first step on at the latest: the
step to the second level closes the loop, whatever the past. Before it, the state is unknown.
"""

import numpy as np

from piezo_identification.conditioning.waveforms import SETTINGS as WAVEFORM
from piezo_recorder.reading.recording import Recording

FEWEST_STEPS = 2
"""Fewest steps between two levels that form a square wave within other voltages; fewer steps never
return to a level."""


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
    if end - begin < half or np.count_nonzero(np.diff(is_high)) < FEWEST_STEPS:
        return recording
    # A slow ramp stays near its level for a while.
    at_level = begin + np.flatnonzero(off_v[begin:end] <= off_v[middle].max())
    kept = np.zeros(voltage_v.size, dtype=bool)
    kept[at_level[0] : at_level[-1] + 1] = True
    return recording.select(kept)
