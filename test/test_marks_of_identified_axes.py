# SPDX-License-Identifier: BSD-3-Clause
"""Marks of a scan come when a stage whose delays were identified is where they say."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piezo_client.scan_marks import marked
from piezo_client.scans import Scanned
from piezo_controller.axes.scan import scan
from piezo_controller.axes.stored_scan import stored_scan
from piezo_identification.axes.identify_axes import identify_several_axes
from piezo_recorder.sample_block import Mark

sys.path.insert(0, str(Path(__file__).parents[1] / "src/piezo_identification/test/axes"))
import flexure

REST_V, REST_UM = (50.0, 40.0), (10.0, 7.0)
"""Operating point in the tables of the flexure."""

LINES, PIXELS, SIZE_UM = 6, 20, 5.0


@pytest.fixture(scope="module")
def identified():
    return identify_several_axes([flexure.recording(columns, f"experiment {number}") for
                                  number, columns in enumerate(flexure.experiments(2048))])


def true_um(voltage_v, monkeypatch):
    """Positions at the instants of the samples: what sensors that are not late would read."""
    with monkeypatch.context() as patch:
        patch.setattr(flexure, "LATE", (0.0, 0.0))
        return flexure.motion_um(voltage_v)


@pytest.fixture(params=[("x", "y"), ("y", "x")], ids=" and ".join)
def plan(identified, request):
    return scan(identified, "raster", axes=request.param, size_um=(SIZE_UM, SIZE_UM),
                rate_hz=100.0, lines=LINES, pixels=PIXELS, both_directions=True)


def played_v(plan):
    """Voltages about the operating point until the motion has settled."""
    return np.concatenate([plan.begin_voltage_v, np.tile(plan.voltage_v, (12, 1))]) - REST_V


def late_samples(plan, marks, monkeypatch):
    """By how much each pixel is marked too late for its place."""
    fast = plan.path.axes.index(plan.frame.axes[0])
    found_um = (true_um(played_v(plan), monkeypatch) + REST_UM)[-len(marks):, fast]
    at = np.flatnonzero(marks & Mark.PIXEL)
    share = (np.arange(PIXELS) + 0.5) / PIXELS - 0.5
    way = np.where(np.arange(LINES) % 2, -1.0, 1.0)
    wanted_um = plan.path.centre_um[fast] + SIZE_UM * np.outer(way, share).ravel()
    return (found_um[at] - wanted_um) / np.gradient(found_um)[at]


def test_pixels_are_marked_within_one_sample_of_their_places(plan, monkeypatch):
    late = late_samples(plan, plan.marks, monkeypatch)
    assert np.abs(late).max() < 0.6  # delays of 0.3 and 1.6 samples are rounded


def test_marks_by_position_are_within_one_sample_where_the_path_is_not_followed(
        plan, monkeypatch):
    followed = replace(plan, voltage_v=(plan.voltage_v - REST_V) * 1.03 + REST_V)
    planned = late_samples(followed, plan.marks, monkeypatch)
    assert np.abs(planned).max() > 1.0
    noise_um = flexure.NOISE_UM * np.random.default_rng(7).normal(size=plan.voltage_v.shape)
    measured_um = flexure.motion_um(played_v(followed))[-len(plan.marks):] + REST_UM + noise_um
    again = marked(Scanned(Path("run"), stored_scan(followed), measured_um))
    assert np.abs(late_samples(followed, again.marks, monkeypatch)).max() < 0.8
    assert np.array_equal(again.voltage_v, followed.voltage_v)


def test_marks_of_the_reading_are_later_by_the_delay(identified):
    plan = scan(identified, "raster", axes=("y", "x"), size_um=(5.0, 5.0), rate_hz=100.0, lines=4)
    undelayed = scan(identified, "raster", axes=("y", "x"), size_um=(5.0, 5.0), rate_hz=100.0,
                     lines=4, sensor_delay_s=(0.0, 0.0))
    assert np.array_equal(undelayed.marks, plan.path.marks)
    assert np.array_equal(plan.marks, np.roll(plan.path.marks, -2))  # y is 1.6 samples late
    assert plan.frame.axes == ["y", "x"]
    assert plan.frame.sensor_delay_s == pytest.approx([1.6e-4, 0.3e-4], abs=0.3e-4)
