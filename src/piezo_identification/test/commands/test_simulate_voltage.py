# SPDX-License-Identifier: BSD-3-Clause
"""`simulate --voltage` predicts from time and voltage alone."""

import numpy as np
import pytest

from piezo_identification.commands.simulate_command import main
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import save_model

PERIOD_S = 1e-3
LACKING = {"dynamics": {"residual_rms_um": 0.19, "noise_rms_um": 1e-3, "ratio": 190.0,
                        "verdict": "inadequate", "error_percent": 2.0}}


@pytest.fixture
def files(tmp_path):
    line = PreisachModel(0.0, 100.0, np.zeros((1, 1)), 0.0, np.array([0.2]))
    model = StageModel(line, CreepDynamics(), ElectricVibrationDynamics(5e-3))
    save_model(tmp_path / "model.json", IdentifiedModel(model, (0.0, 100.0), adequacy=LACKING))
    voltage_v = np.repeat([20.0, 80.0], 200)
    np.savetxt(tmp_path / "voltage.csv",
               np.column_stack([PERIOD_S * np.arange(voltage_v.size), voltage_v]), "%.9g", ",",
               header="time_s,voltage_v", comments="")
    return tmp_path


def run(files, *more):
    return main(["--model", str(files / "model.json"), "--voltage", str(files / "voltage.csv"),
                 *more])


def test_the_displacement_under_a_voltage_is_written_and_a_poor_model_is_said_first(
        files, capsys):
    assert run(files, "--output", str(files / "out")) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0] == (
        "the model is inadequate: the residual of dynamics is 190 times the noise, 2 % of the "
        "motion")
    assert printed[-2] == f"written {files / 'out' / 'predicted.csv'}"
    assert printed[-1].startswith("next: ")
    table = np.genfromtxt(files / "out" / "predicted.csv", delimiter=",", names=True)
    assert table.dtype.names == ("time_s", "voltage_v", "displacement_um")
    late_s = np.maximum(table["time_s"] - 200 * PERIOD_S, 0.0)
    rise_um = 12.0 * -np.expm1(-late_s / 5e-3)
    assert table["displacement_um"] - table["displacement_um"][0] == pytest.approx(
        rise_um, abs=1e-5)


@pytest.mark.parametrize(("more", "sentence"), [
    ([], "--voltage needs --output"),
    (["--output", "out", "--rows-read", "end"], "have nothing to act on with --voltage"),
])
def test_options_that_do_not_go_with_a_voltage_are_refused(files, capsys, more, sentence):
    assert run(files, *more) == 2
    error = capsys.readouterr().err
    assert sentence in error and error.count("\n") == 1
