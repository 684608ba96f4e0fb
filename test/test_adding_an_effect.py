# SPDX-License-Identifier: BSD-3-Clause
"""The effect of docs/adding_an_effect.md, installed from outside, competes like any other."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from piezo_identification.experiments.catalogue import validation
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_document import ModelFileError
from piezo_models.model_file import load_model, save_model

PAGE = Path(__file__).parents[1] / "docs" / "adding_an_effect.md"
COSINE_UM, SINE_UM = 0.03, -0.02


def block(language):
    """The code of the page in one language."""
    return re.search(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)[1]


@pytest.fixture
def outside(tmp_path):
    """Directory with what pip would install of the page's package."""
    directory = tmp_path / "outside"
    metadata = directory / "cyclic_error-1.0.dist-info"
    metadata.mkdir(parents=True)
    (directory / "cyclic_error.py").write_text(block("python"))
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: cyclic-error\nVersion: 1.0\n")
    group, name, target = re.search(
        r'entry-points\."(.*?)"\]\n(\w+) = "(.*?)"', block("toml")).groups()
    (metadata / "entry_points.txt").write_text(f"[{group}]\n{name} = {target}\n")
    return directory


def test_an_effect_from_outside_is_found_and_kept_in_the_model_file(
        outside, plain_model, save_csv, tmp_path):
    save_model(tmp_path / "model.json", IdentifiedModel(plain_model, (-20.0, 120.0)))
    voltage_v = validation(arc_s=0.03, tones_s=0.1).voltage_v
    displacement_um = plain_model.simulate(voltage_v, 25e-6)
    phase = 2.0 * np.pi * displacement_um / 0.3165
    displacement_um += COSINE_UM * np.cos(phase) + SINE_UM * np.sin(phase)
    displacement_um += 0.009 * np.random.default_rng(1).normal(size=voltage_v.size)
    save_csv(tmp_path / "data.csv", 25e-6 * np.arange(voltage_v.size), voltage_v, displacement_um)

    run = subprocess.run(
        [sys.executable, "-m", "piezo_identification.commands.diagnose_command",
         "--model", "model.json", "--data", "data.csv", "--output", "diagnosis"],
        cwd=tmp_path, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(outside), *sys.path])})
    assert run.returncode == 0, run.stderr
    assert "verdict: explained. The model lacks cyclic_error" in run.stdout
    found, = json.loads((tmp_path / "diagnosis" / "verdict.json").read_text())["effects"]
    # The phase goes with the offset, which no recording tells.
    assert np.hypot(*found["parameters"].values()) == pytest.approx(
        np.hypot(COSINE_UM, SINE_UM), rel=0.02)

    extended = tmp_path / "diagnosis" / "extended_model.json"
    assert json.loads(extended.read_text())["effects"][0]["name"] == "cyclic_error"
    with pytest.raises(ModelFileError, match="no effect that is installed here"):
        load_model(extended)
