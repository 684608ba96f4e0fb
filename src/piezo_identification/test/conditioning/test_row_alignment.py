# SPDX-License-Identifier: BSD-3-Clause
"""Rows that are read late, and how late a recording is."""

import numpy as np
import pytest

from piezo_identification.conditioning.row_alignment import (
    away_from_jumps,
    is_point_by_point,
    reading_at_jumps,
    remaining_delay,
    rows_read_at_start,
)
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

PERIOD_S = 0.01
TIME_S = np.arange(2000) * PERIOD_S


def motion_um(time_s):
    return 20.0 + 15.0 * np.sin(1.3 * time_s) + 4.0 * np.sin(5.1 * time_s + 1.0)


def recorded(read_at_samples):
    size = TIME_S.size
    return Recording(
        "logger", 1.0 / PERIOD_S, np.arange(size), np.full(size, PERIOD_S), np.arange(float(size)),
        motion_um(TIME_S + read_at_samples * PERIOD_S),
        np.full(size, Flag.PLAYING, dtype=np.uint32))


@pytest.mark.parametrize(("read_at_samples", "tolerance_um"), [(1.0, 1e-12), (0.37, 1e-5)])
def test_a_row_has_the_displacement_of_its_instant_again(read_at_samples, tolerance_um):
    aligned = rows_read_at_start(recorded(read_at_samples), read_at_samples)
    assert aligned.sample_index[0] == 1
    assert aligned.voltage_v[0] == 1.0
    np.testing.assert_allclose(
        aligned.displacement_um, motion_um(aligned.sample_index * PERIOD_S), atol=tolerance_um)


def test_rows_that_are_read_at_the_start_stay_as_they_are():
    recording = recorded(0.0)
    assert rows_read_at_start(recording, 0.0) is recording


@pytest.mark.parametrize("read_at_samples", [2.0, -1.6, np.nan])
def test_rows_cannot_be_read_after_the_next_voltage(read_at_samples):
    with pytest.raises(ValueError, match="give a number from 0, the start of the hold, to 1.5"):
        rows_read_at_start(recorded(0.0), read_at_samples)


@pytest.mark.parametrize("delay_s", [0.003, -0.002])
def test_a_delay_is_told_with_its_standard_deviation(delay_s):
    normalised = []
    for seed in range(60):
        noise_um = 0.5 * np.random.default_rng(seed).normal(size=TIME_S.size)
        found_s, deviation_s = remaining_delay(
            motion_um(TIME_S - delay_s) + noise_um, motion_um(TIME_S), PERIOD_S,
            np.ones((TIME_S.size, 1)))
        normalised.append((found_s - delay_s) / deviation_s)
    assert np.mean(normalised) == pytest.approx(0.0, abs=0.5)
    assert np.std(normalised) == pytest.approx(1.0, abs=0.3)


def test_what_does_not_move_tells_no_delay():
    still_um = np.zeros(100)
    assert remaining_delay(still_um + 1.0, still_um, PERIOD_S, np.ones((100, 1))) == (0.0, np.inf)


def test_steps_between_which_nothing_moves_tell_no_delay():
    voltage_v = np.repeat([0.0, 50.0, 0.0, 50.0], 200)
    moved_um = np.concatenate([[0.0], 0.2 * voltage_v[:-1]])
    noise_um = 1e-3 * np.random.default_rng(2).normal(size=voltage_v.size)
    delay_s, deviation_s = remaining_delay(
        moved_um + noise_um, 0.2 * voltage_v, PERIOD_S, np.ones((voltage_v.size, 1)),
        away_from_jumps(voltage_v))
    assert abs(delay_s) <= 3.0 * deviation_s


JUMPS_V = np.repeat([0.0, 10.0, 0.0, 10.0], 5)


@pytest.mark.parametrize(("shown", "found"), [
    (-0.1, 0.0), (0.1, 0.0), (0.5, None), (0.9, 1.0), (1.1, 1.0), (3.0, None)])
def test_jumps_tell_an_instant_only_where_their_row_shows_none_or_all_of_them(shown, found):
    jumps = np.flatnonzero(np.diff(JUMPS_V)) + 1
    displacement_um = JUMPS_V.copy()
    displacement_um[jumps] -= (1.0 - shown) * (JUMPS_V[jumps] - JUMPS_V[jumps - 1])
    read_at = reading_at_jumps(slow(JUMPS_V, displacement_um))
    assert str(read_at) == str(found), "0 and not -0, which would be printed"


@pytest.mark.parametrize("voltage_v", [
    pytest.param(np.zeros(1), id="one row"), pytest.param(np.zeros(20), id="no change"),
    pytest.param(np.array([0.0, 10.0, 0.0]), id="nothing held"),
    pytest.param(np.arange(300.0), id="a ramp")])
def test_rows_that_show_no_jump_and_no_points_tell_nothing(voltage_v):
    recording = slow(voltage_v, np.zeros(voltage_v.size))
    assert reading_at_jumps(recording) is None
    assert is_point_by_point(recording) == (voltage_v.size == 3)


def test_jumps_that_move_nothing_tell_nothing():
    assert reading_at_jumps(slow(JUMPS_V, np.zeros(JUMPS_V.size))) is None


def slow(voltage_v, displacement_um):
    size = voltage_v.size
    return Recording(
        "slow logger", 20.0, np.arange(size), np.full(size, 0.05), voltage_v, displacement_um,
        np.full(size, Flag.PLAYING, dtype=np.uint32))
