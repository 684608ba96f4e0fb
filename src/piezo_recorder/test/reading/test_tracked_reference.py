# SPDX-License-Identifier: BSD-3-Clause
"""The reference of a run is read back beside the samples, sample by sample."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from piezo_recorder.reading.frames import to_frame
from piezo_recorder.reading.recording import Recording
from piezo_recorder.reading.sample_account import report
from piezo_recorder.reading.tracked_reference import reference_of

RATE_HZ = 40_000.0


def told(first_sample, *values_um):
    return SimpleNamespace(first_sample=first_sample, displacement_um=np.array(values_um))


@pytest.fixture
def recording():
    count = 200
    displacement_um = np.full(count, 3.0)
    reference_um = np.full(count, np.nan)
    reference_um[50:150] = 3.4
    reference_um[60] = 4.0
    return Recording(
        "runs/track", RATE_HZ, np.arange(count), np.full(count, 1 / RATE_HZ), np.zeros(count),
        displacement_um, np.zeros(count, np.uint32), reference_um=reference_um)


def test_each_sample_has_the_value_of_its_number_and_others_none():
    index = np.array([10, 11, 12, 15, 16, 30])  # 13 and 14 were lost
    reference_um = reference_of([told(15, 5.0, 6.0), told(11, 1.0, 2.0, 3.0, 4.0)], index)
    np.testing.assert_array_equal(reference_um, [np.nan, 1.0, 2.0, 5.0, 6.0, np.nan])


def test_reference_of_other_samples_is_none():
    assert reference_of([told(100, 1.0)], np.arange(50)).size == 0
    assert reference_of([], np.arange(50)).size == 0


def test_part_of_a_recording_has_its_part_of_the_reference(recording):
    part = recording.select(np.isfinite(recording.reference_um))
    assert part.reference_um.size == part.voltage_v.size == 100
    without = replace(recording, reference_um=np.empty(0))
    assert without.select(np.arange(200) < 7).reference_um.size == 0
    assert "reference_um" not in to_frame(without)
    assert to_frame(recording)["reference_um"].max() == 4.0


def test_account_and_summary_tell_the_error_and_the_picture_shows_it(recording):
    rms_um = np.sqrt((99 * 0.4**2 + 1.0) / 100)
    line = next(line for line in report(recording) if line.startswith("reference of 100 samples"))
    assert f"rms error {rms_um:.4g} um, largest 1 um" in line
    rows = {row[0]: row[1] for row in recording.summary().rows}
    assert rows["reference"] == 3.4
    assert rows["rms error, with the way to its beginning"] == pytest.approx(rms_um)
    drawn = [line.get_label() for axes in recording.plot().axes for line in axes.lines]
    assert "reference" in drawn
    without = replace(recording, reference_um=np.empty(0))
    assert not any(line.startswith("reference") for line in report(without))


def test_picture_of_a_run_has_reference_and_error(recording):
    axes = {one.get_ylabel(): one for one in recording.plot().axes if one.get_ylabel()}
    left_um = (recording.reference_um - recording.displacement_um)[50:150]
    np.testing.assert_allclose(axes["error (nm)"].lines[0].get_ydata(), 1e3 * left_um)
    without = replace(recording, reference_um=np.empty(0))
    assert "error (nm)" not in {one.get_ylabel() for one in without.plot().axes}
