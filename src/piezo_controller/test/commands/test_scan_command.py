# SPDX-License-Identifier: BSD-3-Clause
"""`scan` writes the voltages of a path, says how well it will be followed, and refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
import two_axis_flexure

from piezo_common.schema import load_document
from piezo_controller.commands.scan_command import main
from piezo_models import save_axes_model
from piezo_recorder.images.scan_frame import ScanFrame


@pytest.fixture(scope="module")
def model_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.json"
    save_axes_model(path, two_axis_flexure.identified(60.0))
    return path


def test_a_period_its_beginning_and_a_picture_are_written(model_file, tmp_path, capsys,
                                                          picture_faults):
    folder = tmp_path / "scan"
    assert picture_faults(main, [
        "--model", str(model_file), "--size-um", "20", "20", "--lines", "8", "--rate-hz", "100",
        "--both-directions", "--output", str(folder)]) == []
    printed = capsys.readouterr().out
    assert "raster of 20 x 20 um at 100 Hz" in printed
    assert "with deviations" in printed
    assert printed.splitlines()[-1].startswith(
        f"next: ./run piezo_identification simulate --model {model_file} --data <")
    table = np.genfromtxt(folder / "path.csv", delimiter=",", names=True)
    assert table.dtype.names == (
        "time_s", "x_voltage_v", "y_voltage_v", "x_displacement_um", "y_displacement_um", "pixel",
        "line", "frame", "backward")
    assert table["line"].sum() == 8
    assert table["pixel"].sum() == 64
    begin = np.genfromtxt(folder / "begin.csv", delimiter=",", names=True)
    assert begin["x_voltage_v"][0] == 0.0
    step = np.abs(np.diff(table["x_voltage_v"])).max()
    assert abs(begin["x_voltage_v"][-1] - table["x_voltage_v"][0]) < 2.0 * step
    frame = load_document(ScanFrame, folder / "scan.json")
    assert frame.pixels == [8, 8] and frame.marked_pixels == 64
    assert frame.size_um == pytest.approx((20.0, 20.0 * 8 / 7))  # lines lie on the edges
    assert (folder / "path.png").stat().st_size > 1000


@pytest.mark.parametrize(("given", "said"), [
    (["--size-um", "90", "90", "--lines", "4", "--rate-hz", "100"],
     "available are -60 to 60 V; within reach are 23."),
    (["--pattern", "file"], "a file needs a file: give --file"),
    (["--pattern", "file", "--file", __file__, "--size-um", "5", "5", "--rate-hz", "20"],
     "has its own positions: leave out --size-um, --rate-hz"),
    (["--file", "here"], "here does not exist"),
    (["--axes", "x", "z"], "the path moves z, and the model has the axes x, y"),
    (["--pattern", "points", "--file", "points.csv"], "points.csv has the columns x, y: give")])
def test_what_cannot_be_is_refused_in_one_line(model_file, tmp_path, monkeypatch, capsys, given,
                                               said):
    monkeypatch.chdir(tmp_path)
    Path("points.csv").write_text("x,y\n1,2\n3,4\n")
    assert main(["--model", str(model_file), *given, "--output", "scan"]) == 2
    refused = capsys.readouterr().err
    assert said in refused
    assert refused.count("\n") == 1
    assert not Path("scan").exists()


def test_a_model_of_one_axis_is_refused(tmp_path, capsys):
    path = tmp_path / "model.json"
    path.write_text(json.dumps({"format": "piezo_stage_model", "version": 1}))
    assert main(["--model", str(path), "--output", str(tmp_path / "scan")]) == 2
    assert "version 1 is of one axis" in capsys.readouterr().err
