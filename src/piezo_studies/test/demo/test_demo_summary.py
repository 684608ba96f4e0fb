# SPDX-License-Identifier: BSD-3-Clause
import json

import numpy as np
import pytest

from piezo_studies.demo.summary import (
    aligned,
    model_error_rows,
    summarise,
    summarise_run,
    table_rows,
    tracking_error_rows,
)
from piezo_studies.demo.tracked_run import read_tracked_run

SAMPLES = 4000  # 0.1 s


def sine_error(size_um, offset_um=0.0):
    """Return an error of this RMS around an offset, orthogonal to the reference."""
    phase = 2 * np.pi * 300.0 * np.arange(SAMPLES) / 40_000
    return offset_um + size_um * np.sqrt(2.0) * np.sin(phase)


def test_only_the_periodic_part_of_a_run_is_read(tracking_recordings, tmp_path):
    voltage_v = np.linspace(1.0, 2.0, SAMPLES)
    run = read_tracked_run(tracking_recordings.write(
        tmp_path / "run", error_um=0.25, true_error_um=0.5, voltage_v=voltage_v))
    assert run.error_um == pytest.approx(np.full(SAMPLES, 0.25))
    assert run.reference_um - run.true_um == pytest.approx(np.full(SAMPLES, 0.5))
    assert run.voltage_v == pytest.approx(voltage_v)
    assert run.time_s[[0, -1]] == pytest.approx([0.0, 0.1 - 2.5e-5])


def test_the_summary_gives_the_errors_that_the_recording_was_made_with(
        tracking_recordings, tmp_path):
    run = read_tracked_run(tracking_recordings.write(
        tmp_path / "runs" / "one", error_um=sine_error(0.4, offset_um=0.3),
        true_error_um=sine_error(0.2), missed=3))
    entry, = summarise([run], {"e_y_percent": 0.1}, tmp_path)["tracking"]
    assert entry["e_rms_percent"] == pytest.approx(100 * 0.5 / 40)
    assert entry["e_rms_true_percent"] == pytest.approx(100 * 0.2 / 40)
    assert entry["e_rms_without_offset_percent"] == pytest.approx(100 * 0.4 / 40)
    assert entry["offset_um"] == pytest.approx(0.3)
    assert entry["largest_error_um"] == pytest.approx(0.3 + 0.4 * np.sqrt(2), rel=1e-3)
    assert (entry["frequency_hz"], entry["amplitude_um"], entry["mode"]) == (100, 40, "composite")
    assert entry["missed_feedback"] == 3
    assert entry["thesis_e_rms_percent"] == 1.21
    assert entry["recording"] == "runs/one"


def test_the_lockstep_ratio_counts_the_time_of_the_closed_loop_alone(tracking_recordings, tmp_path):
    slow = tracking_recordings.write(tmp_path / "slow", block_wall_s=0.001)
    quick = tracking_recordings.write(tmp_path / "quick", block_wall_s=0.00025)
    without = tracking_recordings.write(tmp_path / "ff", mode="feedforward", block_wall_s=0.1)
    runs = [read_tracked_run(path) for path in (slow, quick, without)]
    assert summarise(runs, {}, tmp_path)["lockstep_ratio"] == pytest.approx(2 / 1.25)
    with pytest.raises(ValueError, match="no run with feedback"):
        summarise(runs[2:], {}, tmp_path)


def test_the_summary_survives_json(tracking_recordings, tmp_path):
    run = read_tracked_run(tracking_recordings.write(tmp_path / "run", frequency_hz=200.0))
    summary = summarise([run], {"e_y_percent": 0.04}, tmp_path)
    assert json.loads(json.dumps(summary)) == summary
    assert summary["identification"] == {"e_y_percent": 0.04}


def test_the_table_sets_the_thesis_beside_ours_and_a_dash_where_it_has_none(
        tracking_recordings, tmp_path):
    runs = [read_tracked_run(tracking_recordings.write(
        tmp_path / mode, mode=mode, error_um=0.2)) for mode in ("feedforward", "composite")]
    head, rule, *rows = aligned(table_rows(summarise(runs, {}, tmp_path))).splitlines()
    assert [row.split()[:5] for row in rows] == [
        ["100", "40", "feedforward", "0.500", "-"], ["100", "40", "composite", "0.500", "1.21"]]
    assert len({len(line) for line in (head, rule, *rows)}) == 1


def test_errors_before_and_after_stand_side_by_side(tracking_recordings, tmp_path):
    before, after = (
        read_tracked_run(tracking_recordings.write(tmp_path / f"{error_um}", error_um=error_um))
        for error_um in (0.2, 0.02))
    summary = {
        **summarise([before], {}, tmp_path),
        "tracking_after": [summarise_run(after, tmp_path)],
        "diagnosis": {"before": {"rms_um": 0.03, "e_y_percent": 0.1},
                      "after": {"rms_um": 0.0111, "e_y_percent": 0.04}}}
    *_, row = aligned(tracking_error_rows(summary)).splitlines()
    assert row.split() == ["100", "40", "composite", "0.500", "0.050", "1.21"]
    *_, rms, e_y = aligned(model_error_rows(summary)).splitlines()
    assert rms.split()[-2:] == ["30.0", "11.1"] and e_y.split()[-2:] == ["0.100", "0.040"]


def test_a_recording_without_ground_truth_or_parameters_is_refused(tracking_recordings, tmp_path):
    with pytest.raises(ValueError, match="ground_truth"):
        read_tracked_run(tracking_recordings.write(tmp_path / "run", truth=False))
    csv = tmp_path / "data.csv"
    csv.write_text("time_s,voltage_v,displacement_um\n0,0,0\n1,0,0\n", encoding="utf-8")
    with pytest.raises(ValueError, match="no parameters.json"):
        read_tracked_run(csv)
