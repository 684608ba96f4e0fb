# SPDX-License-Identifier: BSD-3-Clause
"""The adequacy in a model file: kept, checked, and absent from older files."""

import json

import numpy as np
import pytest

from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_document import ModelFileError
from piezo_models.model_file import load_model, save_model

ADEQUACY = {
    "creep": {"residual_rms_um": 1e-3, "noise_rms_um": 9e-4, "ratio": 1.11, "verdict": "adequate",
              "error_percent": 0.1, "noise_from": "repeats"},
    "dynamics": {"residual_rms_um": 0.19, "noise_rms_um": 1e-3, "ratio": 190.0,
                 "verdict": "inadequate", "error_percent": 2.0, "noise_from": "repeats",
                 "left": "0.19 um near 1400 Hz", "advice": "ask for --modes 3"},
}


@pytest.fixture
def path(tmp_path, stage):
    path = tmp_path / "model.json"
    save_model(path, IdentifiedModel(stage, (-20.0, 120.0), adequacy=ADEQUACY))
    return path


def edited(path, edit):
    document = json.loads(path.read_text())
    edit(document)
    path.write_text(json.dumps(document))
    return path


def test_what_an_inadequate_part_costs_is_one_sentence(stage):
    identified = IdentifiedModel(
        stage, (-20.0, 120.0), adequacy=ADEQUACY, errors={"e_y_percent": 3.4})
    assert identified.shortfall() == (
        "the model is inadequate: the residual of dynamics is 190 times the noise, 2 % of the "
        "motion; on data "
        "that was not fitted it is wrong by 3.4 %")
    assert IdentifiedModel(stage, (-20.0, 120.0)).shortfall() == ""
    adequate = {"creep": ADEQUACY["creep"]}
    assert IdentifiedModel(stage, (-20.0, 120.0), adequacy=adequate).shortfall() == ""


def test_a_voltage_alone_is_enough_for_a_prediction(stage):
    """The stage has rested at the first voltage: it stays there until the voltage changes."""
    identified = IdentifiedModel(stage, (-20.0, 120.0))
    voltage_v = np.repeat([30.0, 60.0], 100)
    displacement_um = identified.predict(voltage_v, 1e-3)
    assert displacement_um[:100] == pytest.approx(np.full(100, displacement_um[0]), abs=1e-6)
    assert displacement_um[-1] > displacement_um[0] + 1.0
    assert displacement_um == pytest.approx(
        stage.simulate(voltage_v, 1e-3, stage.memory(30.0)))
    with pytest.raises(ValueError, match="give at least one voltage"):
        identified.predict([], 1e-3)


def test_the_adequacy_comes_back(path):
    assert load_model(path).adequacy == ADEQUACY


def test_an_older_file_has_none_and_is_read(path):
    assert load_model(edited(path, lambda document: document.pop("adequacy"))).adequacy == {}


@pytest.mark.parametrize(("field", "value", "said"), [
    ("verdict", "good", "adequacy.creep.verdict is not 'adequate' or 'inadequate'"),
    ("ratio", -1.0, "adequacy.creep.ratio is out of range"),
    ("left", None, "adequacy.creep.left is null"),
    ("mood", 1.0, "adequacy.creep.mood is unknown"),
])
def test_a_wrong_entry_is_named(path, field, value, said):
    with pytest.raises(ModelFileError, match=said):
        load_model(edited(
            path, lambda document: document["adequacy"]["creep"].update({field: value})))
