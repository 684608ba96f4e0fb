# SPDX-License-Identifier: BSD-3-Clause
"""What the estimators read off a recording before they fit anything."""

from dataclasses import dataclass

import numpy as np


def played(recording):
    """Part of a recording in which a waveform or a trajectory plays, without ramps.

    Raises
    ------
    ValueError
        If nothing plays, or samples are missing in it.
    """
    part = recording.select(recording.playing | recording.tracking)
    if part.gaps:
        first, count = part.gaps[0]
        raise ValueError(
            f"{recording.path} lacks {count} samples from sample {first} on: the hysteresis "
            "depends on every voltage, record it again"
        )
    return part


def with_voltage_before(recording, part):
    """Voltage of a part of a recording, with that before it, which the hysteresis remembers too.

    Returns
    -------
    voltage_v : (M,) array
    lead : int
        Samples of it that come before the part.
    """
    before = np.asarray(recording.voltage_v)[recording.sample_index < part.sample_index[0]]
    return np.concatenate([before, part.voltage_v]).astype(float), before.size


def samples_per_mean(recording):
    """Clock samples of which each displacement is the mean; 1 where nothing was averaged."""
    return max(1, round(recording.sample_period_s * recording.sample_rate_hz))


@dataclass(frozen=True)
class SquareWave:
    """A voltage that takes two levels.

    Parameters
    ----------
    level : ndarray, shape (N,)
        0 at the lower voltage, 1 at the upper one.
    steps : ndarray of int
        Samples at which the level changes.
    """

    level: np.ndarray
    steps: np.ndarray


def square_wave(recording):
    """Read a recording's voltage as a square wave.

    Raises
    ------
    ValueError
        If the voltage takes other values than two levels, or never changes.
    """
    voltage_v = recording.voltage_v
    low_v, high_v = voltage_v.min(), voltage_v.max()
    swing_v = high_v - low_v
    level = (voltage_v > 0.5 * (low_v + high_v)).astype(float)
    if swing_v == 0.0 or np.abs(voltage_v - low_v - swing_v * level).max() > 0.01 * swing_v:
        raise ValueError(
            f"{recording.path} is no square wave between two voltages: "
            "give the recording of a creep or dynamics experiment"
        )
    return SquareWave(level, np.flatnonzero(np.diff(level)) + 1)


def turning_points(voltage_v, threshold_v):
    """Samples at which the voltage reverses, with the first and the last sample.

    Parameters
    ----------
    voltage_v : ndarray, shape (N,)
    threshold_v : float
        A way back shorter than this is no reversal.

    Returns
    -------
    ndarray of int
    """
    moves = np.flatnonzero(np.diff(voltage_v)) + 1
    points, extreme, direction = [0], 0, 0
    for sample in moves:
        travel_v = voltage_v[sample] - voltage_v[extreme]
        if direction * travel_v >= 0.0 and (direction or abs(travel_v) > threshold_v):
            extreme, direction = sample, direction or int(np.sign(travel_v))
        elif direction and abs(travel_v) > threshold_v:
            points.append(extreme)
            extreme, direction = sample, -direction
    if extreme != points[-1]:
        points.append(extreme)
    if points[-1] != voltage_v.size - 1:
        points.append(voltage_v.size - 1)
    return np.array(points)


def sample_by_voltage(voltage_v, levels_v):
    """Input-based sampling rule (4.9)-(4.10): the samples nearest to the levels.

    Between two reversals every level is taken once, where the voltage comes nearest to it. L
    harmonics of rising amplitude from level 0 give L (L + 1) + 1 samples.

    Parameters
    ----------
    voltage_v : ndarray, shape (N,)
    levels_v : ndarray, shape (L + 1,)
        Uniform and increasing.

    Returns
    -------
    ndarray of int
        Increasing.
    """
    spacing_v = levels_v[1] - levels_v[0]
    points = turning_points(voltage_v, 0.25 * spacing_v)
    samples = [np.array([0])]
    for start, end in zip(points[:-1], points[1:], strict=True):
        branch_v = voltage_v[start : end + 1]
        direction = 1.0 if branch_v[-1] >= branch_v[0] else -1.0
        rising_v = np.maximum.accumulate(direction * branch_v)
        wanted_v = np.sort(direction * levels_v)
        # Half a quantum of any converter lies within this.
        slack_v = 1e-3 * spacing_v
        wanted_v = wanted_v[
            (wanted_v >= rising_v[0] - slack_v) & (wanted_v <= rising_v[-1] + slack_v)
        ]
        after = np.clip(np.searchsorted(rising_v, wanted_v), 1, rising_v.size - 1)
        nearer = np.abs(rising_v[after - 1] - wanted_v) <= np.abs(rising_v[after] - wanted_v)
        samples.append(start + after - nearer)
    return np.unique(np.concatenate(samples))
