# SPDX-License-Identifier: BSD-3-Clause
"""`check`, `identify` and `simulate` on files of several axes."""

import sys
from pathlib import Path

import numpy as np
import pytest

from piezo_identification.commands.check_command import main as check_main
from piezo_identification.commands.identify_command import main as identify_main
from piezo_identification.commands.simulate_command import main as simulate_main
from piezo_models.axes_model_file import load_axes_model, save_axes_model
from piezo_models.model_document import ModelFileError
from piezo_models.model_file import load_model

sys.path.insert(0, str(Path(__file__).parent))
import flexure


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flexure")
    found = []
    for name, columns in zip(("x", "y", "both"), flexure.experiments(samples=2048), strict=True):
        np.savetxt(folder / f"{name}.csv", np.column_stack(list(columns.values())), "%.9g", ",",
                   header=",".join(columns), comments="")
        found.append(folder / f"{name}.csv")
    return found


@pytest.fixture(scope="module")
def model(files):
    path = files[0].parent / "model.json"
    assert identify_main(["--dynamics", str(files[0]), str(files[1]), "--modes", "4",
                          "--validation", str(files[2]), "--output", str(path)]) == 0
    return path


def test_the_model_file_has_axes_modes_and_errors(model):
    identified = load_axes_model(model)
    assert identified.model.axes == ("x", "y")
    assert identified.model.poles_rad_per_s.size >= 4
    assert set(identified.errors) == {"x", "y"}
    assert all(error["e_y_percent"] < 5.0 for error in identified.errors.values())
    assert len(identified.recordings) == 2
    assert "x from y" in repr(identified.summary())


def test_a_model_that_is_saved_again_is_the_same(model, tmp_path):
    identified = load_axes_model(model)
    save_axes_model(tmp_path / "again.json", identified)
    again = load_axes_model(tmp_path / "again.json")
    frequency_hz = np.geomspace(1.0, 4000.0, 50)
    np.testing.assert_allclose(again.model.response(frequency_hz),
                               identified.model.response(frequency_hz), rtol=1e-9)
    np.testing.assert_allclose(again.coupling.deviation_um_per_v,
                               identified.coupling.deviation_um_per_v)


def test_simulate_prints_an_error_for_each_axis(model, files, tmp_path, capsys):
    assert simulate_main(["--model", str(model), "--data", str(files[2]), "--output",
                          str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "x e_y_percent" in printed
    assert "y e_y_percent" in printed
    assert (tmp_path / "displacement.png").stat().st_size > 1000


def test_check_says_which_axis_moves(files, tmp_path, capsys):
    assert check_main(["--data", *map(str, files), "--output", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "at rest throughout: y" in printed
    assert f"--dynamics {files[0]} {files[1]}" in printed


def test_files_of_one_axis_beside_those_of_several_are_refused(files, tmp_path, capsys):
    one = tmp_path / "one.csv"
    one.write_text("time_s,voltage_v,displacement_um\n0,0,0\n1,1,1\n")
    assert identify_main(["--dynamics", str(files[0]), str(one), "--output",
                          str(tmp_path / "model.json")]) == 2
    assert "is of one axis and" in capsys.readouterr().err


def test_options_of_one_axis_are_refused(files, tmp_path, capsys):
    assert identify_main(["--dynamics", *map(str, files), "--grid", "20", "--output",
                          str(tmp_path / "model.json")]) == 2
    assert "--grid is for one axis" in capsys.readouterr().err


def test_steps_of_one_axis_refuse_a_model_of_several(model):
    with pytest.raises(ModelFileError, match="a model of several axes"):
        load_model(model)


def test_a_matrix_of_another_size_is_refused(model, tmp_path):
    text = model.read_text()
    start = text.index('"residue_re_um_per_v": [') + len('"residue_re_um_per_v": [')
    broken = tmp_path / "broken.json"
    broken.write_text(text[:start] + "[1.0, 2.0], " + text[start:])
    with pytest.raises(ModelFileError, match="no matrix of 2 by 2"):
        load_axes_model(broken)
