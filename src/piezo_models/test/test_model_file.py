# SPDX-License-Identifier: BSD-3-Clause
import json
import os
from dataclasses import replace

import numpy as np
import pytest

from piezo_common import text_file
from piezo_models.cascade import StageModel
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import ElectricVibrationDynamics
from piezo_models.model_document import ModelFileError
from piezo_models.model_file import load_model, save_model


@pytest.fixture
def identified(stage):
    return IdentifiedModel(
        model=stage,
        voltage_range_v=(-20.0, 120.0),
        sample_periods_s={"creep": 0.01, "dynamics": np.float64(25e-6)},
        errors={"e_y_percent": 0.123, "unseen": {"rms_um": np.float32(0.5)}},
        recordings=[{"path": "runs/größe/creep", "sha256": "ab" * 32}],
        rows={"dynamics": {"read_at_samples": 1.0, "delay_s": 2e-6, "standard_deviation_s": 1e-7},
              "creep": {"read_at_samples": 1.0, "standard_deviation_s": np.inf}},
    )


@pytest.fixture
def path(tmp_path, identified):
    path = tmp_path / "model with space.json"
    save_model(path, identified)
    return path


def change(path, edit):
    document = json.loads(path.read_text())
    edit(document)
    path.write_text(json.dumps(document))


def test_model_comes_back_to_the_bit(path, identified):
    loaded = load_model(path)
    was, now = identified.model, loaded.model
    assert np.array_equal(now.hysteresis.density_um_per_v2, was.hysteresis.density_um_per_v2)
    for name in ("voltage_min_v", "voltage_max_v", "offset_um"):
        assert getattr(now.hysteresis, name) == getattr(was.hysteresis, name)
    assert now.creep == was.creep
    assert now.dynamics == was.dynamics
    assert loaded.voltage_range_v == identified.voltage_range_v
    assert loaded.sample_periods_s == identified.sample_periods_s
    assert loaded.errors == identified.errors
    assert loaded.recordings == identified.recordings
    assert loaded.created == identified.created
    assert loaded.rows == identified.rows


def test_second_saving_is_the_same_text(path, tmp_path):
    again = tmp_path / "again.json"
    save_model(again, load_model(path))
    assert again.read_bytes() == path.read_bytes()


def test_antiresonances_are_kept(identified, tmp_path, uneven_model):
    dynamics = ElectricVibrationDynamics(1e-3, (900.0,), (0.1,), (700.0,), (0.05,))
    identified.model = StageModel(uneven_model, identified.model.creep, dynamics)
    save_model(tmp_path / "m.json", identified)
    assert load_model(tmp_path / "m.json").model.dynamics == dynamics


def test_file_is_readable_with_a_row_of_the_density_a_line(path):
    lines = path.read_text().splitlines()
    start = next(n for n, line in enumerate(lines) if '"density_um_per_v2"' in line)
    for i, line in enumerate(lines[start + 1 : start + 21]):
        assert len(json.loads(line.strip().rstrip(","))) == i + 1
    assert max(map(len, lines)) < 600


def remove(*names):
    def edit(document):
        for name in names[:-1]:
            document = document[name]
        del document[names[-1]]

    return edit


def put(value, *names):
    def edit(document):
        for name in names[:-1]:
            document = document[name]
        document[names[-1]] = value

    return edit


@pytest.mark.parametrize(
    ("edit", "field"),
    [
        (remove("format"), "format"),
        (put("something else", "format"), "format"),
        (put(2, "version"), "version is 2, not 1"),
        (put(True, "version"), "version"),
        (remove("version"), "version"),
        (remove("hysteresis"), "hysteresis is missing"),
        (remove("hysteresis", "offset_um"), "hysteresis.offset_um is missing"),
        (remove("creep", "zeros_rad_per_s"), "creep.zeros_rad_per_s is missing"),
        (remove("dynamics", "time_constant_s"), "dynamics.time_constant_s is missing"),
        (remove("recordings", 0, "sha256"), "recordings[0].sha256 is missing"),
        (put(1, "surprise"), "surprise is unknown"),
        (put([], "hysteresis"), "hysteresis is not an object"),
        (put("2", "hysteresis", "offset_um"), "hysteresis.offset_um is not a finite number"),
        (put(True, "hysteresis", "offset_um"), "hysteresis.offset_um is not a finite number"),
        (put(10**400, "hysteresis", "offset_um"), "hysteresis.offset_um is not a finite number"),
        (put(200.0, "hysteresis", "voltage_min_v"), "hysteresis: the voltage range"),
        (put([], "hysteresis", "density_um_per_v2"), "density_um_per_v2 has 0 entries"),
        (put([1.0], "hysteresis", "density_um_per_v2", 3), "density_um_per_v2[3]"),
        (put(None, "hysteresis", "density_um_per_v2", 3, 2), "density_um_per_v2[3][2]"),
        (put(-1e-9, "hysteresis", "density_um_per_v2", 3, 2), "um_per_v2[3][2] is out of range"),
        (put([1.0], "creep", "poles_rad_per_s"), "creep: "),
        (put(-1.0, "dynamics", "time_constant_s"), "dynamics.time_constant_s is out of range"),
        (put([120.0, -20.0], "voltage_range_v"), "voltage_range_v"),
        (put([1.0], "voltage_range_v"), "voltage_range_v"),
        (put({"creep": 0}, "sample_periods_s"), "sample_periods_s.creep"),
        (put({"e": {"f": "x"}}, "errors"), "errors.e.f"),
        (put("x", "recordings"), "recordings"),
        (put(5, "created"), "created"),
    ],
)
def test_unsound_file_is_refused_with_path_and_field(path, edit, field):
    change(path, edit)
    with pytest.raises(ModelFileError) as refusal:
        load_model(path)
    message = str(refusal.value)
    assert message.startswith(f"{path}: ")
    assert field in message
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "not valid JSON"),
        (b"not json", "not valid JSON"),
        (b"{" + b'"format": NaN}', "NaN"),
        (b'{"format": 1, "format": 1}', "repeated"),
        (b"[" * 100_000, "not valid JSON"),
        (b"1" * 5000, "not valid JSON"),
        (b"\xff\xfe\x00", "not text"),
        (b"[1, 2]", "format"),
        (b"null", "format"),
    ],
)
def test_other_content_is_refused(tmp_path, content, problem):
    path = tmp_path / "other.json"
    path.write_bytes(content)
    with pytest.raises(ModelFileError, match=problem) as refusal:
        load_model(path)
    assert str(path) in str(refusal.value)


def test_infinity_written_as_a_large_number_is_refused(path):
    text = path.read_text().replace('"offset_um": -3.0', '"offset_um": 1e999')
    path.write_text(text)
    with pytest.raises(ModelFileError, match="hysteresis.offset_um is not a finite number"):
        load_model(path)


def test_missing_file_and_directory_are_refused(tmp_path):
    for path in (tmp_path / "absent.json", tmp_path):
        with pytest.raises(ModelFileError, match="cannot be read|not a regular file"):
            load_model(path)


def test_huge_file_is_refused_unread(tmp_path):
    path = tmp_path / "huge.json"
    path.touch()
    os.truncate(path, 10**11)
    with pytest.raises(ModelFileError, match="more than"):
        load_model(path)


def test_unsound_model_is_not_saved_and_the_old_file_stays(path, identified):
    before = path.read_bytes()
    identified.errors = {"e_y_percent": float("nan")}
    with pytest.raises(ModelFileError, match="errors.e_y_percent"):
        save_model(path, identified)
    identified.errors = {}
    density = -np.eye(2)
    identified.model = StageModel(
        PreisachModel(0.0, 1.0, density), identified.model.creep, identified.model.dynamics
    )
    with pytest.raises(ModelFileError, match=r"density_um_per_v2\[0\]\[0\] is out of range"):
        save_model(path, identified)
    assert path.read_bytes() == before
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_interrupted_writing_leaves_the_old_file(path, identified, monkeypatch):
    before = path.read_bytes()

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(text_file.os, "replace", fail)
    identified.created = "later"
    with pytest.raises(ModelFileError, match="No space left"):
        save_model(path, identified)
    assert path.read_bytes() == before
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


def test_directory_that_is_not_there_is_refused(tmp_path, identified):
    with pytest.raises(ModelFileError, match="cannot be written"):
        save_model(tmp_path / "absent" / "model.json", identified)


def test_saved_file_is_as_readable_as_any_new_file(path, tmp_path):
    plain = tmp_path / "plain"
    plain.touch()
    assert path.stat().st_mode == plain.stat().st_mode


def test_uncertainties_come_back_in_the_shape_of_the_parameters(identified, tmp_path):
    creep, dynamics = identified.model.creep, identified.model.dynamics
    identified.uncertainties = {
        "creep": {
            "poles_rad_per_s": tuple(1e-3 * p for p in creep.poles_rad_per_s),
            "zeros_rad_per_s": [1e-3 * z for z in creep.zeros_rad_per_s],
        },
        "dynamics": {
            "time_constant_s": np.float64(1e-6),
            "mode_frequencies_rad_per_s": [0.5] * len(dynamics.mode_frequencies_rad_per_s),
            "damping_ratios": [1e-3] * len(dynamics.damping_ratios),
            "antiresonance_frequencies_rad_per_s": [],
            "antiresonance_damping_ratios": [],
        },
    }
    save_model(tmp_path / "m.json", identified)
    loaded = load_model(tmp_path / "m.json").uncertainties
    assert loaded["dynamics"]["time_constant_s"] == 1e-6
    assert loaded["creep"]["zeros_rad_per_s"] == identified.uncertainties["creep"][
        "zeros_rad_per_s"
    ]


def test_an_uncertainty_that_no_data_told_is_saved_as_null(identified, tmp_path):
    creep = identified.model.creep
    identified.uncertainties = {"creep": {
        "poles_rad_per_s": (np.inf, *[0.01] * (len(creep.poles_rad_per_s) - 1)),
        "zeros_rad_per_s": (0.01,) * len(creep.zeros_rad_per_s)}}
    save_model(tmp_path / "m.json", identified)
    stored = json.loads((tmp_path / "m.json").read_text())["uncertainties"]
    assert stored["creep"]["poles_rad_per_s"][0] is None
    loaded = load_model(tmp_path / "m.json").uncertainties["creep"]
    assert loaded["poles_rad_per_s"][0] == np.inf
    assert loaded["poles_rad_per_s"][1:] == [0.01] * (len(creep.poles_rad_per_s) - 1)


@pytest.mark.parametrize(("edit", "named"), [
    (lambda u: u["creep"].pop("zeros_rad_per_s"), "uncertainties.creep.zeros_rad_per_s is missing"),
    (lambda u: u["creep"]["zeros_rad_per_s"].append(1.0), "uncertainties.creep.zeros_rad_per_s is"),
    (lambda u: u["creep"]["zeros_rad_per_s"].__setitem__(0, -1.0), "is out of range"),
    (lambda u: u.update(hysteresis={}), "uncertainties.hysteresis is unknown"),
    (lambda u: u.update(effects=[{"delay_s": 1.0}] * 9),
     r"uncertainties.effects is not a list of \d+ objects \(found 9\)"),
])
def test_uncertainties_that_do_not_fit_the_model_are_refused(path, edit, named):
    def add(document):
        document["uncertainties"] = {"creep": {
            name: [0.1] * len(values) for name, values in document["creep"].items()
        }}
        edit(document["uncertainties"])
    change(path, add)
    with pytest.raises(ModelFileError, match=named):
        load_model(path)


def test_visited_cells_are_kept_and_those_that_do_not_fit_the_density_refused(identified, tmp_path):
    density = identified.model.hysteresis.density_um_per_v2
    identified.visited = np.tril(np.random.default_rng(0).random(density.shape) < 0.5)
    path = tmp_path / "m.json"
    save_model(path, identified)
    assert np.array_equal(load_model(path).visited, identified.visited)
    change(path, lambda document: document["visited"].pop())
    with pytest.raises(ModelFileError, match="visited is no triangle"):
        load_model(path)


def test_a_parameter_that_was_added_since_has_its_default(identified, tmp_path):
    loops = BoucWenHysteresis(1.0, 4.0, 0.5)
    identified.model = replace(identified.model, effects=(loops,))
    path = tmp_path / "m.json"
    save_model(path, identified)
    document = json.loads(path.read_text())
    del document["effects"][0]["parameters"]["exponent"]
    path.write_text(json.dumps(document))
    assert load_model(path).model.effects == (loops,)
    del document["effects"][0]["parameters"]["saturation_v"]
    path.write_text(json.dumps(document))
    with pytest.raises(ModelFileError, match="saturation_v is missing"):
        load_model(path)
