# SPDX-License-Identifier: BSD-3-Clause
"""The sampling rules of the thesis for harmonics of rising amplitude: by time or by voltage."""

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.waveforms import turning_points

SMALLEST_BRANCH = 0.25
"""Smallest reversal, as a fraction of the distance between two levels."""

LEVEL_SLACK = 1e-3
"""Distance from a level within which a branch counts as reaching it, as a fraction of the distance
between levels; it is more than half a step of any converter."""


def sample_by_voltage(voltage_v: FloatArray, levels_v: FloatArray) -> NDArray[np.intp]:
    """Choose the samples nearest to the levels: the input-based sampling rule (4.9)-(4.10).

    Between two reversals, one sample is chosen for each of the uniform levels, (L + 1,), where the
    voltage is nearest to it. L harmonics of rising amplitude from level 0 give L (L + 1) + 1
    samples.
    """
    spacing_v = levels_v[1] - levels_v[0]
    points = turning_points(voltage_v, SMALLEST_BRANCH * spacing_v)
    samples = [np.array([0])]
    for start, end in zip(points[:-1], points[1:], strict=True):
        branch_v = voltage_v[start : end + 1]
        direction = 1.0 if branch_v[-1] >= branch_v[0] else -1.0
        rising_v = np.maximum.accumulate(direction * branch_v)
        wanted_v = np.sort(direction * levels_v)
        slack_v = LEVEL_SLACK * spacing_v
        wanted_v = wanted_v[
            (wanted_v >= rising_v[0] - slack_v) & (wanted_v <= rising_v[-1] + slack_v)
        ]
        after = np.clip(np.searchsorted(rising_v, wanted_v), 1, rising_v.size - 1)
        nearer = np.abs(rising_v[after - 1] - wanted_v) <= np.abs(rising_v[after] - wanted_v)
        samples.append(start + after - nearer)
    return np.unique(np.concatenate(samples))


def stair_sample_times(
    amplitudes_v: FloatArray, harmonic_period_s: float, voltages_v: FloatArray,
) -> FloatArray:
    """Return the increasing times at which harmonics cross given voltages, (3.9)-(3.10) and (4.10).

    The voltages increase from above zero: multiples of the step for (4.10); middles of the steps
    for (3.9)-(3.10), whose amplitudes are middles, too. From time 0 on, each harmonic gives one
    time for every voltage that it reaches while it rises and while it falls, one for its peak, and
    one for its return to zero.
    """
    times_s = [np.zeros(1)]
    for i, amplitude_v in enumerate(amplitudes_v):
        reached_v = voltages_v[voltages_v <= amplitude_v * (1.0 + 1e-12)]
        share = np.minimum(reached_v / amplitude_v, 1.0)
        rising_s = np.arccos(1.0 - 2.0 * share) / (2.0 * np.pi) * harmonic_period_s
        falling_s = harmonic_period_s - rising_s[::-1]
        at_peak = share[-1:] == 1.0
        times_s.append(i * harmonic_period_s + np.concatenate([
            rising_s, falling_s[1:] if at_peak.all() and share.size else falling_s,
            [harmonic_period_s],
        ]))
    return np.concatenate(times_s)
