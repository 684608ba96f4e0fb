# SPDX-License-Identifier: BSD-3-Clause
"""`identify` on data of an independent stage, some of them wrong: nothing goes without a word."""

import re
from itertools import pairwise

import numpy as np
import pytest

from piezo_identification.commands.identify_command import main as identify_main
from piezo_models.model_file import load_model

PERIOD_S = 0.05
TURNS_V = (0.0, 60.0, 0.0, 40.0, 10.0, 50.0, 20.0, 55.0, 0.0, 30.0, 5.0, 60.0, 0.0)
ASKED = ("--grid", "40", "--smoothing", "1e-10", "--translation-weight", "1e-10")
VOLTAGE_V = np.concatenate([
    *(np.linspace(start, end, 100, endpoint=False) for start, end in pairwise(TURNS_V)), [0.0]])


@pytest.fixture(scope="module")
def displacement_um(independent_stage):
    past_v = (0.0, 60.0, 0.0)
    noise = 0.005 * np.random.default_rng(1).normal(size=VOLTAGE_V.size)
    return independent_stage((), ()).displacement_um(VOLTAGE_V, PERIOD_S, past_v) + noise


@pytest.fixture
def identified(save_csv, tmp_path, capsys):
    def identified(displacement_um, *more, status=0):
        path, model = tmp_path / "loops.csv", tmp_path / "model.json"
        save_csv(path, np.arange(VOLTAGE_V.size) * PERIOD_S, VOLTAGE_V, displacement_um)
        assert identify_main(["--no-report", "--hysteresis", str(path),
                              "--output", str(model), *more]) == status
        said = capsys.readouterr()
        return (said.out, load_model(model)) if status == 0 else (said.err, None)
    return identified


def test_the_error_on_the_fitted_data_is_always_printed_and_what_was_tried_if_asked_for(
        displacement_um, identified):
    out, model = identified(displacement_um, *ASKED)
    part = model.adequacy["hysteresis"]
    assert part["error_percent"] < 0.5
    assert part["residual_rms_um"] == pytest.approx(0.005, rel=0.5)
    (row,) = (line for line in out.splitlines() if line.startswith("hysteresis   "))
    assert row.split()[-1] == part["verdict"]
    assert "start of the hysteresis: begins at 0 V" not in out
    assert "implausible" not in out
    results = out.partition("100 %  done")[2].splitlines()
    assert len(results) < 20 and results[1].startswith("identified: ")
    told, _ = identified(displacement_um, *ASKED, "--verbose")
    assert "start of the hysteresis: begins at 0 V" in told
    assert "error on" not in told and "Model identified" in told
    assert model.model.first_rise is None


def test_a_sensor_that_clips_in_the_wrong_unit_is_said_twice(displacement_um, identified):
    limit_um = np.quantile(displacement_um, 0.6)
    out, model = identified(5e-3 * np.minimum(displacement_um, limit_um), *ASKED)
    assert "implausible: " in out
    assert len(re.findall(r"stays at its highest value, .* in 40 % of the samples", out)) == 1
    assert "is implausible for a piezo stage: is the displacement in um" in out
    assert "(40 %) are outliers or clipped, and were left out" in out
    assert model.adequacy["hysteresis"]["verdict"] == "adequate"


def test_a_butterfly_is_refused_and_no_model_written(displacement_um, identified, tmp_path):
    middle_um = displacement_um - np.mean(displacement_um[[0, 100]])
    err, _ = identified(0.2 * middle_um**2, status=2)
    assert len(err.splitlines()) == 1
    assert "loops.csv holds a butterfly loop" in err
    assert not (tmp_path / "model.json").exists()
