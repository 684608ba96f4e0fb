# SPDX-License-Identifier: BSD-3-Clause
"""Marks are put where late sensors have shown the axes at the places of a path."""

import numpy as np
import pytest

from piezo_controller.axes.path_marks import lead_samples, marks_by_position
from piezo_controller.axes.patterns import ScanPattern, scan_path
from piezo_recorder.sample_block import Mark

PERIOD_S = 2.5e-5
DELAYS = np.array([7.0, 3.0])
"""Of the readings of both axes, in samples."""


def drawn(kind, **fields):
    """Return the path, its marks as they are planned, and the samples that they mark."""
    path = scan_path(ScanPattern(kind, rate_hz=50.0, **fields), PERIOD_S)
    lead = lead_samples(path.position_um, path.marks, DELAYS)
    return path.position_um, np.roll(path.marks, -lead).astype(np.uint8), lead


def read_um(true_um):
    """Return what the late sensors read of a periodic motion."""
    return np.column_stack([np.roll(column, round(late)) for column, late in zip(
        true_um.T, DELAYS, strict=True)])


RASTER = {"lines": 6, "pixels": 30, "both_directions": True}


def test_a_path_that_is_followed_keeps_the_marks_of_the_plan():
    position_um, marks, lead = drawn("raster", **RASTER)
    assert lead == 7  # lines run along the first axis
    assert np.array_equal(marks_by_position(position_um, marks, position_um, DELAYS), marks)


def test_marks_of_lines_in_both_directions_move_towards_each_other_by_an_offset():
    position_um, marks, _ = drawn("raster", **RASTER)
    offset_um = [3.0 * 10.0 / 640, 0.0]  # three samples: a line of 10 um has 640
    found = marks_by_position(position_um, marks, position_um + offset_um, DELAYS)
    moved = np.flatnonzero(found & Mark.PIXEL) - np.flatnonzero(marks & Mark.PIXEL)
    backward = marks[marks & Mark.PIXEL > 0] & Mark.BACKWARD > 0
    assert set(moved[~backward]) == {-3} and set(moved[backward]) == {3}
    assert np.array_equal(found[found > 0], marks[marks > 0])


@pytest.mark.parametrize(("kind", "fields"), [
    ("raster", RASTER), ("spiral", {"lines": 5, "pixels": 40}), ("rosette", {"lines": 8})])
def test_places_are_marked_within_a_sample_on_a_motion_that_lags_and_is_noisy(kind, fields):
    position_um, marks, lead = drawn(kind, **fields)
    true_um = np.roll(1.02 * position_um, 9, axis=0)
    noise_um = 0.002 * np.random.default_rng(2).normal(size=true_um.shape)
    found = marks_by_position(position_um, marks, read_um(true_um) + noise_um, DELAYS)
    places = (np.flatnonzero(marks & Mark.PIXEL) + lead) % len(marks)
    late_um = true_um[np.flatnonzero(found & Mark.PIXEL)] - position_um[places]
    velocity_um = np.gradient(position_um, axis=0)[places]
    late = np.sum(late_um * velocity_um, axis=1) / np.sum(velocity_um**2, axis=1)
    assert len(late) >= 64 and np.abs(late).max() < 1.0


def test_a_vibration_that_is_shorter_than_a_pixel_moves_the_marks():
    position_um, marks, lead = drawn("raster", lines=4, pixels=2, both_directions=True)
    sample_um, time = 10.0 / 640, np.arange(len(marks))
    true_um = position_um.copy()
    true_um[:, 0] += 4.0 * sample_um * np.sin(2.0 * np.pi * time / 70)
    noise_um = 0.5 * sample_um * np.random.default_rng(5).normal(size=true_um.shape)
    found = marks_by_position(position_um, marks, read_um(true_um) + noise_um, DELAYS)
    places = (np.flatnonzero(marks & Mark.PIXEL) + lead) % len(marks)
    late_um = true_um[np.flatnonzero(found & Mark.PIXEL)] - position_um[places]
    assert np.abs(late_um[:, 0]).max() < 1.5 * sample_um


def test_turns_beside_the_planned_ones_are_marked_where_they_come_closest_to_the_places():
    position_um, marks, lead = drawn("spiral", lines=5, pixels=40)
    true_um = position_um + [0.2, 0.1]
    found = marks_by_position(position_um, marks, read_um(true_um), DELAYS)
    places = (np.flatnonzero(marks & Mark.PIXEL) + lead) % len(marks)
    late_um = true_um[np.flatnonzero(found & Mark.PIXEL)] - position_um[places]
    velocity_um = np.gradient(true_um, axis=0)[np.flatnonzero(found & Mark.PIXEL)]
    late = np.sum(late_um * velocity_um, axis=1) / np.sum(velocity_um**2, axis=1)
    outside = np.linalg.norm(position_um[places], axis=1) > 1.0
    assert np.count_nonzero(outside) > 300 and np.abs(late[outside]).max() < 1.0


def test_no_mark_is_lost_where_each_sample_has_one():
    angle_rad = 2.0 * np.pi * np.arange(400) / 400
    position_um = 10.0 * np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])
    noise_um = 0.05 * np.random.default_rng(0).normal(size=position_um.shape)
    marks = np.full(400, Mark.PIXEL, np.uint8)
    found = marks_by_position(position_um, marks, position_um + noise_um, np.zeros(2))
    assert np.array_equal(found, marks)


def test_places_that_are_not_passed_and_rests_keep_their_marks():
    position_um, marks, _ = drawn("raster", **RASTER)
    still_um = np.tile(position_um.mean(axis=0), (len(marks), 1))
    assert np.array_equal(marks_by_position(position_um, marks, still_um, DELAYS), marks)
    at_um, marks, _ = drawn("points", points_um=[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    noise_um = 0.003 * np.random.default_rng(3).normal(size=at_um.shape)
    assert np.array_equal(marks_by_position(at_um, marks, at_um + noise_um, DELAYS), marks)
