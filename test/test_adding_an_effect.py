# SPDX-License-Identifier: BSD-3-Clause
"""The effect of docs/adding_an_effect.md, installed from outside, competes like any other."""

import json
import sys

import numpy as np
import pytest

from piezo_identification.commands.diagnose_command import main
from piezo_identification.experiments.catalogue import validation
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_document import ModelFileError
from piezo_models.model_file import load_model, save_model

COSINE_UM, SINE_UM = 0.03, -0.02


def test_an_effect_from_outside_is_found_and_kept_in_the_model_file(
        package_of_page, plain_model, save_csv, tmp_path, capsys, without_pictures,
        without_ceiling):
    save_model(tmp_path / "model.json", IdentifiedModel(plain_model, (-20.0, 120.0)))
    voltage_v = validation(arc_s=0.01, tones_s=0.1).voltage_v
    displacement_um = plain_model.simulate(voltage_v, 25e-6)
    phase = 2.0 * np.pi * displacement_um / 0.3165
    displacement_um += COSINE_UM * np.cos(phase) + SINE_UM * np.sin(phase)
    displacement_um += 0.009 * np.random.default_rng(1).normal(size=voltage_v.size)
    save_csv(tmp_path / "data.csv", 25e-6 * np.arange(voltage_v.size), voltage_v, displacement_um)

    with pytest.MonkeyPatch.context() as installed:
        installed.syspath_prepend(package_of_page("adding_an_effect.md"))
        installed.chdir(tmp_path)
        status = main(["--model", "model.json", "--data", "data.csv", "--output", "diagnosis"])
        sys.modules.pop("cyclic_error", None)
    printed = capsys.readouterr()
    assert status == 0, printed.err
    assert "verdict: explained. The model lacks cyclic_error" in printed.out
    found, = json.loads((tmp_path / "diagnosis" / "verdict.json").read_text())["effects"]
    # The phase goes with the offset, which no recording tells.
    assert np.hypot(*found["parameters"].values()) == pytest.approx(
        np.hypot(COSINE_UM, SINE_UM), rel=0.02)

    extended = tmp_path / "diagnosis" / "extended_model.json"
    assert json.loads(extended.read_text())["effects"][0]["name"] == "cyclic_error"
    with pytest.raises(ModelFileError, match="no effect that is installed here"):
        load_model(extended)
