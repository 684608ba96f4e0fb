# SPDX-License-Identifier: BSD-3-Clause
"""Properties of voltages."""

import numpy as np
import pytest

from piezo_identification.conditioning.waveforms import has_holds, turns_inside
from piezo_recorder import recording_of

TIME_S = 0.1 * np.arange(4000)
NOISE_V = 0.02 * np.random.default_rng(1).normal(size=TIME_S.size)


@pytest.mark.parametrize("voltage_v, expected", [
    (20.0 * np.floor(TIME_S / 80.0), True),
    (np.where(TIME_S % 100.0 < 50.0, 0.0, 90.0) + NOISE_V, True),
    (np.interp(TIME_S % 130.0, [0.0, 10.0, 60.0, 70.0, 130.0], [0.0, 80.0, 80.0, 0.0, 0.0]), True),
    (np.interp(TIME_S, [0.0, 200.0, 400.0], [0.0, 90.0, 0.0]), False),
    (45.0 - 45.0 * np.cos(0.05 * TIME_S) + NOISE_V, False),
    (np.random.default_rng(2).uniform(0.0, 90.0, TIME_S.size), False)])
def test_holds_are_levels_for_much_of_the_time(voltage_v, expected):
    assert has_holds(recording_of({
        "time_s": TIME_S, "voltage_v": voltage_v, "displacement_um": voltage_v})) is expected


@pytest.mark.parametrize("levels, inside", [
    ([0.0, 100.0, 0.0, 100.0], False), ([0.0, 100.0, 20.0, 100.0], True),
    ([0.0, 60.0, 0.0, 100.0, 0.0], True), ([30.0, 100.0, 0.0], False)])
def test_a_voltage_that_turns_at_the_ends_of_its_range_runs_one_loop(levels, inside):
    voltage_v = np.interp(np.linspace(0.0, len(levels) - 1.0, 997), range(len(levels)), levels)
    voltage_v += np.random.default_rng(1).normal(scale=0.05, size=voltage_v.size)
    assert turns_inside([voltage_v]) == inside


def test_loops_of_two_recordings_may_have_two_sizes():
    small_v, large_v = (np.abs(np.linspace(-size, size, 301)) for size in (40.0, 90.0))
    assert not turns_inside([small_v])
    assert turns_inside([90.0 - small_v, large_v, np.tile(small_v, 2)])
