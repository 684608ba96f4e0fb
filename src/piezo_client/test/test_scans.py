# SPDX-License-Identifier: BSD-3-Clause
"""A planned path is read as it was written, and its last period is compared with what was asked."""

import dataclasses
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

from piezo_client import stage_command, stage_work
from piezo_client.results import Played
from piezo_client.scan_marks import marked
from piezo_client.scans import Scanned, scanned
from piezo_controller.axes.stored_scan import BEGIN_FILE, PERIOD_FILE, read_scan, write_scan
from piezo_recorder.images.scan_frame import ScanFrame
from piezo_recorder.reading.recording import Recording, RecordingError
from piezo_recorder.sample_block import Flag, Mark

SAMPLES, BEGIN, PERIOD_S = 80, 30, 1e-4
PHASE = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
VOLTAGE_V = np.column_stack([50.0 + 10.0 * np.cos(PHASE), 40.0 + 5.0 * np.sin(PHASE)])
POSITION_UM = 0.2 * VOLTAGE_V


def write(path, columns):
    np.savetxt(path, np.column_stack(list(columns.values())), "%.9g", ",",
               header=",".join(columns), comments="")


@pytest.fixture
def folder(tmp_path):
    write(tmp_path / PERIOD_FILE, {
        "time_s": PERIOD_S * np.arange(SAMPLES), "x_voltage_v": VOLTAGE_V[:, 0],
        "y_voltage_v": VOLTAGE_V[:, 1], "x_displacement_um": POSITION_UM[:, 0],
        "y_displacement_um": POSITION_UM[:, 1], "pixel": np.zeros(SAMPLES)})
    begin_v = 50.0 + (VOLTAGE_V[0] - 50.0) * np.linspace(0.0, 1.0, BEGIN)[:, None]
    write(tmp_path / BEGIN_FILE, {"time_s": PERIOD_S * np.arange(BEGIN),
                                  "x_voltage_v": begin_v[:, 0], "y_voltage_v": begin_v[:, 1]})
    return tmp_path


def recorded(scan, periods, error_um, ramp=7):
    """Return a recording of a scan that is followed with an error, between two ramps."""
    played_um = np.concatenate([np.zeros((BEGIN, 2)), *[scan.position_um] * (periods - 1),
                                scan.position_um + error_um])
    displacement_um = np.pad(played_um, ((ramp, ramp), (0, 0)))
    flags = np.full(len(displacement_um), Flag.RAMPING, dtype=np.uint32)
    flags[ramp:-ramp] = Flag.PLAYING
    count = len(flags)
    return Recording("run", 10_000.0, np.arange(count), np.full(count, PERIOD_S),
                     np.zeros((count, 2)), displacement_um, flags, axes=("x", "y"))


def frame_of(marked_pixels):
    return ScanFrame(
        format="piezo_scan", version=1, path="raster of a test", axes=["x", "y"], pixels=[8, 5],
        pixel_um=[0.1, 0.2], centre_um=[1.0, 2.0], marked_pixels=marked_pixels,
        sensor_delay_s=[0.0, 1e-5])


@dataclasses.dataclass(frozen=True)
class Kept(Played):
    """A run whose recording need not be read."""

    kept: Recording

    def recording(self):
        return self.kept


def test_planned_path_is_read_as_it_was_written(folder):
    scan = read_scan(folder)
    assert scan.axes == ("x", "y") and scan.sample_period_s == PERIOD_S
    assert np.allclose(scan.voltage_v, VOLTAGE_V, rtol=1e-8)
    assert np.allclose(scan.position_um, POSITION_UM, rtol=1e-8)
    assert np.array_equal(scan.repeated_v(3)[BEGIN + SAMPLES:BEGIN + 2 * SAMPLES], scan.voltage_v)
    assert len(scan.repeated_v(3)) == BEGIN + 3 * SAMPLES


def test_error_is_that_of_the_last_period_without_its_offset(folder):
    scan = read_scan(folder)
    error_um = np.column_stack([0.3 + 0.04 * np.sqrt(2.0) * np.sin(3.0 * PHASE),
                                np.full(SAMPLES, -0.1)])
    run = scanned(scan, Kept(Path("run"), recorded(scan, 2, error_um)), 2)
    assert run.offset_um == pytest.approx([0.3, -0.1])
    assert run.error_percent == pytest.approx([1.0, 0.0], abs=1e-6)  # 0.04 um of 4 um
    table = str(run.summary())
    assert "x" in table and "offset removed" in table


def test_command_prints_the_error_of_each_axis_and_what_may_follow(folder, monkeypatch, capsys):
    scan = read_scan(folder)
    run = scanned(scan, Kept(Path("run"), recorded(scan, 2, 0.0)), 2)
    stage = MagicMock(scan=lambda *given, feedback: run if given == (
        scan, 2, Path("runs")) and feedback is None else None)
    monkeypatch.setattr(stage_work, "read_scan", {folder: scan}.get)
    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    monkeypatch.setattr(stage_work, "Stage", lambda *_: nullcontext(stage))
    assert stage_command.main(["scan", str(folder), "--output", "runs"]) == 0
    printed = capsys.readouterr().out
    assert str(run.summary()) in printed and "recorded run" in printed
    assert "next: ./run piezo_identification simulate --model <MODEL> --data run" in printed


@pytest.mark.parametrize("given", [
    ["--size-um", "5", "5"], ["--rate-hz", "5"], ["--both-directions"], ["--file", "path.csv"],
    ["--voltage-range-v", "0", "90"], ["--compare"]])
def test_command_refuses_options_that_a_planned_path_ignores(folder, monkeypatch, capsys, given):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    monkeypatch.setattr(stage_work, "Stage", lambda *_: nullcontext(MagicMock()))
    assert stage_command.main(["scan", str(folder), "--output", "runs", *given]) == 2
    assert f"is planned already: leave out {given[0]}, or plan again" in capsys.readouterr().err


def test_command_that_learns_prints_every_run_and_wants_a_model(folder, monkeypatch, capsys):
    scan = read_scan(folder)
    runs = [scanned(scan, Kept(Path(f"run_{number}"), recorded(scan, 2, error_um)), 2)
            for number, error_um in enumerate((np.sin(PHASE)[:, None] * [0.4, 0.2], 0.0))]
    stage = MagicMock(learn_scan=lambda *given: runs if given == (
        scan, folder / PERIOD_FILE, 4, 2, Path("runs")) else [])
    monkeypatch.setattr(stage_work, "read_scan", {folder: scan}.get)
    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    monkeypatch.setattr(stage_work, "Stage", lambda *_: nullcontext(stage))
    command = ["scan", str(folder), "--output", "runs", "--learn", "4"]
    assert stage_command.main(command) == 2
    assert "stage: learning divides the error by the response" in capsys.readouterr().err
    assert stage_command.main([*command, "--model", str(folder / PERIOD_FILE)]) == 0
    printed = capsys.readouterr().out
    assert "run_0: error of x 7.071 %, y 7.071 %\nrun_1: error of x 0 %, y 0 %\n" in printed
    assert "recorded run_1" in printed and "Last period of run_1" in printed


def test_command_wants_one_path_and_a_model_to_plan_it(folder, monkeypatch, capsys):
    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    monkeypatch.setattr(stage_work, "Stage", lambda *_: nullcontext(MagicMock()))
    for given, said in (
            ([], "there is no path, or there are two: give a folder"),
            ([str(folder), "--pattern", "raster"], "there is no path, or there are two"),
            (["--pattern", "raster"], "is planned with a model of the axes: give --model"),
            (["--pattern", "file", "--model", str(folder / PERIOD_FILE)], "give --file")):
        assert stage_command.main(["scan", *given, "--output", "runs"]) == 2
        assert said in capsys.readouterr().err


def test_marks_and_frame_are_kept_with_the_voltages_and_repeated_with_them(folder):
    marks = np.arange(SAMPLES).astype(np.uint8) % 16
    frame = frame_of(40)
    scan = dataclasses.replace(read_scan(folder), marks=marks, frame=frame)
    write_scan(scan, folder / "again")
    found = read_scan(folder / "again")
    assert np.array_equal(found.marks, marks) and found.frame == frame
    assert np.array_equal(found.repeated_marks(2), np.r_[np.zeros(BEGIN), marks, marks])
    assert not read_scan(folder).repeated_marks(2).any() and read_scan(folder).frame is None


def test_command_marks_by_position_in_a_further_run(folder, monkeypatch, capsys):
    marks = np.zeros(SAMPLES, np.uint8)
    marks[10:70:10] = Mark.PIXEL
    bare = read_scan(folder)
    scan = dataclasses.replace(bare, marks=marks, frame=frame_of(6))
    played = []

    def play(given, periods, directory, name="scan", feedback=None):
        played.append((given, name, feedback))
        return Scanned(Path("run"), scan, np.roll(scan.position_um, 3, axis=0))

    monkeypatch.setattr(stage_work, "read_scan", {folder: scan}.get)
    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    stage = MagicMock(scan=play, description=MagicMock(signals=[]))
    monkeypatch.setattr(stage_work, "Stage", lambda *_: nullcontext(stage))
    law = folder / "law.json"
    law.touch()
    assert stage_command.main(["scan", str(folder), "--output", str(folder / "runs"),
                               "--marks-by-position", "--feedback", str(law)]) == 0
    first, (marked_scan, *_), without = played
    assert first == (scan, "scan", law) and without == (scan, "planned", None)
    assert played[1][1:] == ("scan", law)
    assert np.array_equal(marked_scan.marks, np.roll(marks, 3))
    assert np.array_equal(read_scan(folder / "runs" / "marked").marks, marked_scan.marks)
    printed = capsys.readouterr().out
    assert "planned:\n" in printed and "planned and feedback:\n" in printed
    with pytest.raises(ValueError, match="has no pixels whose places could be measured"):
        marked(Scanned(Path("run"), bare, scan.position_um))
    monkeypatch.setattr(stage_work, "read_scan", {folder: bare}.get)
    assert stage_command.main(["scan", str(folder), "--output", "runs", "--marks-by-position"]) == 2
    assert "has no pixels" in capsys.readouterr().err and len(played) == 3


def test_command_reports_a_run_of_which_no_image_can_be_made(folder, monkeypatch, capsys):
    scan = dataclasses.replace(read_scan(folder), frame=frame_of(6))
    run = Scanned(Path("run"), scan, scan.position_um)
    stage = MagicMock(scan=lambda *_, **__: run, description=MagicMock(signals=["camera"]))
    monkeypatch.setattr(stage_work, "read_scan", {folder: scan}.get)
    monkeypatch.setattr(stage_work.signal, "signal", lambda *_: None)
    monkeypatch.setattr(stage_work, "Stage", lambda *_: nullcontext(stage))

    def refused(*_):
        raise RecordingError("the pixels lie on a line")

    monkeypatch.setattr(stage_work, "images_of", refused)
    assert stage_command.main(["scan", str(folder), "--output", str(folder / "runs")]) == 0
    printed = capsys.readouterr().out
    assert "recorded run" in printed and "no image: the pixels lie on a line" in printed


def test_axis_that_rests_is_compared_with_the_largest_travel(folder):
    scan = dataclasses.replace(read_scan(folder), position_um=POSITION_UM * [1.0, 0.0])
    run = Scanned(Path("run"), scan, scan.position_um + [0.0, 1.0] * np.sin(PHASE)[:, None])
    assert run.error_percent[1] == pytest.approx(100.0 * np.sqrt(0.5) / 4.0)


def test_recording_without_the_whole_scan_is_refused(folder):
    scan = read_scan(folder)
    with pytest.raises(ValueError, match="run does not hold the whole scan: play it again"):
        scanned(scan, Kept(Path("run"), recorded(scan, 2, 0.0)), 3)


def test_files_of_two_scans_are_refused(folder):
    write(folder / BEGIN_FILE, {"time_s": [0.0, PERIOD_S], "x_voltage_v": [0.0, 0.0],
                                "z_voltage_v": [0.0, 0.0]})
    with pytest.raises(ValueError, match=r"begin\.csv and path\.csv have not the same axes"):
        read_scan(folder)
