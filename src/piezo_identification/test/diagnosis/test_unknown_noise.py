# SPDX-License-Identifier: BSD-3-Clause
"""Random voltages that change with every row: what a model lacks looks like noise there."""

import numpy as np
import pytest

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

pytestmark = pytest.mark.long
PERIOD_S, SAMPLES, NOISE_UM, GAIN_UM_PER_V = 1e-3, 4000, 0.044, 0.3
LINE = StageModel(
    PreisachModel(-60.0, 60.0, np.zeros((1, 1)), -18.0, np.array([GAIN_UM_PER_V])),
    CreepDynamics(), ElectricVibrationDynamics())


@pytest.fixture
def random_rows(recorded):
    """Record a line, and a ripple over the voltage that no effect on the list has."""
    def record(ripple_um, resting=0):
        voltage_v = np.random.default_rng(1).uniform(-50.0, 50.0, SAMPLES)
        voltage_v[SAMPLES - resting :] = 0.0
        displacement_um = GAIN_UM_PER_V * voltage_v + ripple_um * np.sin(0.4 * voltage_v)
        return recorded("random", voltage_v, displacement_um, PERIOD_S, NOISE_UM)

    return record


def test_what_follows_from_the_voltage_does_not_pass_for_noise_that_nothing_shows(random_rows):
    diagnosis = diagnose(LINE, [random_rows(1.4)])
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.probabilities["something_else"] > 0.95
    assert "No recording at hand shows the noise" in diagnosis.left
    assert diagnosis.ceiling["from_voltage_um"] == pytest.approx(1.0, rel=0.1)


def test_a_good_model_of_random_rows_lacks_nothing(random_rows):
    diagnosis = diagnose(LINE, [random_rows(0.0)])
    assert (diagnosis.verdict, diagnosis.effects) == ("none", [])
    assert "nothing follows from the voltage" in diagnosis.left


def test_a_rest_shows_the_noise(random_rows):
    diagnosis = diagnose(LINE, [random_rows(1.4, resting=1000)])
    assert diagnosis.verdict == "unexplained"
    assert "times the noise of 4" in diagnosis.left
    assert diagnose(LINE, [random_rows(0.0, resting=1000)]).verdict == "none"
