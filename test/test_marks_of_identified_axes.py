# SPDX-License-Identifier: BSD-3-Clause
"""Marks of a scan come when a stage whose delays were identified is where they say."""

import sys
from pathlib import Path

import numpy as np
import pytest

from piezo_controller.axes.scan import scan
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


@pytest.mark.parametrize("axes", [("x", "y"), ("y", "x")])
def test_pixels_are_marked_within_one_sample_of_their_places(identified, axes, monkeypatch):
    plan = scan(identified, "raster", axes=axes, size_um=(SIZE_UM, SIZE_UM), rate_hz=100.0,
                lines=LINES, pixels=PIXELS, both_directions=True)
    voltage_v = np.concatenate([plan.begin_voltage_v, np.tile(plan.voltage_v, (12, 1))]) - REST_V
    samples = len(plan.voltage_v)
    fast = ("x", "y").index(axes[0])
    found_um = (true_um(voltage_v, monkeypatch) + REST_UM)[-samples:, fast]
    at = np.flatnonzero(plan.marks & Mark.PIXEL)
    share = (np.arange(PIXELS) + 0.5) / PIXELS - 0.5
    way = np.where(np.arange(LINES) % 2, -1.0, 1.0)
    wanted_um = plan.path.centre_um[fast] + SIZE_UM * np.outer(way, share).ravel()
    late = (found_um[at] - wanted_um) / np.gradient(found_um)[at]
    assert np.abs(late).max() < 0.6  # delays of 0.3 and 1.6 samples are rounded


def test_marks_of_the_reading_are_later_by_the_delay(identified):
    plan = scan(identified, "raster", axes=("y", "x"), size_um=(5.0, 5.0), rate_hz=100.0, lines=4)
    undelayed = scan(identified, "raster", axes=("y", "x"), size_um=(5.0, 5.0), rate_hz=100.0,
                     lines=4, sensor_delay_s=(0.0, 0.0))
    assert np.array_equal(undelayed.marks, plan.path.marks)
    assert np.array_equal(plan.marks, np.roll(plan.path.marks, -2))  # y is 1.6 samples late
    assert plan.frame.axes == ["y", "x"]
    assert plan.frame.sensor_delay_s == pytest.approx([1.6e-4, 0.3e-4], abs=0.3e-4)
