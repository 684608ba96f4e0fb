# SPDX-License-Identifier: BSD-3-Clause
"""The adequacy in a model file: kept, checked, and absent from older files."""

import json

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
