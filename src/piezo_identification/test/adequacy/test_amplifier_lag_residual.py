# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from made_by_scipy import logged

from piezo_identification.adequacy.component_residual import component_residual
from piezo_models.cascade import StageModel
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

PERIOD_S = 25e-6


@pytest.mark.parametrize(("knows", "least_um", "most_um"), [(True, 0.0, 1e-6), (False, 0.05, 20.0)])
def test_a_lag_in_front_of_the_hysteresis_is_part_of_the_residual_of_a_square_wave(
        knows, least_um, most_um):
    hysteresis = PreisachModel(-20.0, 120.0, np.tril(np.full((20, 20), 0.004)), 0.0)
    dynamics = ElectricVibrationDynamics(2e-4, (4000.0,), (0.1,))
    model = StageModel(hysteresis, CreepDynamics(), dynamics, effects=(AmplifierLag(1e-4),))
    voltage_v = np.tile(np.repeat([80.0, 20.0], 400), 22)
    recording = logged(voltage_v, model.simulate(voltage_v, PERIOD_S), PERIOD_S)
    tried = model if knows else StageModel(hysteresis, CreepDynamics(), dynamics)
    left_um = component_residual("dynamics", tried, recording).residual_um
    assert least_um <= np.sqrt(np.mean(left_um**2)) < most_um
