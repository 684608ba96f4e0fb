# SPDX-License-Identifier: BSD-3-Clause
"""The recordings of the identification: found where they are, refused where they have changed."""

import json
from pathlib import Path

import numpy as np
import pytest

from piezo_identification.commands.diagnose_command import main
from piezo_identification.diagnosis.joint.identification_recordings import (
    find_identification_recordings,
)
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recordings, sha256_of

PERIOD_S = 1e-3


@pytest.fixture
def files(tmp_path, save_csv):
    """A straight stage, three recordings of it, and a model that names the first two of them."""
    paths = {}
    for seed, name in enumerate(("creep", "hysteresis", "new")):
        generator = np.random.default_rng(seed)
        voltage_v = np.convolve(generator.normal(size=2000), np.hanning(60), mode="same")
        displacement_um = 0.1 * voltage_v + 2e-3 * generator.normal(size=2000)
        paths[name] = save_csv(tmp_path / f"{name}.csv", PERIOD_S * np.arange(2000), voltage_v,
                               displacement_um)
    stage = StageModel(
        PreisachModel(-100.0, 100.0, np.zeros((1, 1)), -10.0, np.array([0.1])),
        CreepDynamics(), ElectricVibrationDynamics())
    paths["identified"] = IdentifiedModel(stage, (-100.0, 100.0), recordings=[
        {"path": str(paths[name]), "sha256": sha256_of(paths[name])}
        for name in ("creep", "hysteresis")])
    paths["model"] = tmp_path / "model.json"
    save_model(paths["model"], paths["identified"])
    return paths


def found(files, *moved, others=()):
    return find_identification_recordings(
        files["identified"], files["model"], read_recordings, moved, others)


def names(known):
    return [Path(recording.path).stem for recording in known.recordings]


def test_recordings_are_found_where_the_model_file_names_them(files):
    known = found(files)
    assert names(known) == ["creep", "hysteresis"]
    assert (known.missing, known.not_asked) == ((), "")


def test_what_is_diagnosed_is_not_asked_twice(files):
    assert names(found(files, others=[files["creep"]])) == ["hysteresis"]


def test_a_relative_path_counts_from_the_folder_of_the_model(files):
    for entry in files["identified"].recordings:
        entry["path"] = Path(entry["path"]).name
    assert names(found(files)) == ["creep", "hysteresis"]


def test_a_recording_that_has_changed_is_not_used_and_one_that_moved_is(files, tmp_path):
    moved = files["creep"].rename(tmp_path / "elsewhere.csv")
    with files["hysteresis"].open("a") as file:
        file.write("2.0,0.0,0.0\n")
    known = found(files)
    assert known.recordings == ()
    assert "creep.csv is not there" in known.not_asked
    assert "hysteresis.csv has changed since" in known.not_asked
    known = found(files, moved)
    assert names(known) == ["elsewhere"]
    assert "of some of the recordings" in known.not_asked


def test_another_recording_is_refused(files):
    with pytest.raises(ValueError, match=r"new\.csv is none of the recordings that"):
        found(files, files["new"])


@pytest.mark.parametrize(("data", "holdout", "what"), [
    ("new", "new", "are diagnosed"),
    ("new", "creep", "the model was identified from"),
])
def test_a_recording_that_was_fitted_is_not_held_out(files, tmp_path, capsys, data, holdout, what):
    assert main(["--model", str(files["model"]), "--data", str(files[data]), "--holdout",
                 str(files[holdout]), "--output", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr().err.splitlines()[-1]
    assert "cannot be held out" in printed and what in printed


def test_rows_are_aligned_as_for_the_identification(files):
    identified = files["identified"]
    identified.sample_periods_s = {"creep": PERIOD_S, "hysteresis": PERIOD_S}
    identified.rows = {"hysteresis": {"read_at_samples": 1.0, "delay_s": 0.0,
                                      "standard_deviation_s": 0.0}}
    raw = [read_recordings(files[name])[0] for name in ("creep", "hysteresis")]
    aligned = found(files).recordings
    np.testing.assert_array_equal(aligned[0].displacement_um, raw[0].displacement_um)
    np.testing.assert_array_equal(aligned[1].displacement_um, raw[1].displacement_um[:-1])
    np.testing.assert_array_equal(aligned[1].voltage_v, raw[1].voltage_v[1:])


@pytest.mark.long
@pytest.mark.usefixtures("without_pictures")
def test_the_command_says_what_it_could_not_ask(files, tmp_path, capsys):
    def diagnose(*more):
        assert main(["--model", str(files["model"]), "--data", str(files["new"]),
                     "--output", str(tmp_path / "out"), *map(str, more)]) == 0
        verdict = json.loads((tmp_path / "out" / "verdict.json").read_text())
        return verdict["identified_from"], capsys.readouterr().out

    moved = files["creep"].rename(tmp_path / "elsewhere.csv")
    document, told = diagnose()
    assert "creep.csv is not there" in document["not_asked"]
    assert told.splitlines().count(document["not_asked"]) == 1
    assert "--identified-from" in document["not_asked"]
    document, told = diagnose("--identified-from", moved)
    assert document == {"recordings": [str(moved), str(files["hysteresis"])], "not_asked": ""}
    assert "not tested" not in told
