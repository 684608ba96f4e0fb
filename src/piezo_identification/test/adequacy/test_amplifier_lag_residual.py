# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_identification.adequacy.component_residual import component_residual
from piezo_models.cascade import StageModel
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

PERIOD_S = 25e-6


@pytest.mark.parametrize(("knows", "least_um", "most_um"), [(True, 0.0, 1e-6), (False, 0.05, 20.0)])
def test_a_lag_in_front_of_the_hysteresis_is_part_of_the_residual_of_a_square_wave(
        knows, least_um, most_um):
    hysteresis = PreisachModel(-20.0, 120.0, np.tril(np.full((20, 20), 0.004)), 0.0)
    dynamics = ElectricVibrationDynamics(2e-4, (4000.0,), (0.1,))
    model = StageModel(hysteresis, CreepDynamics(), dynamics, effects=(AmplifierLag(1e-4),))
    voltage_v = np.tile(np.repeat([80.0, 20.0], 400), 22)
    recording = Recording(
        __file__, 1.0 / PERIOD_S, np.arange(voltage_v.size), np.full(voltage_v.size, PERIOD_S),
        voltage_v, model.simulate(voltage_v, PERIOD_S),
        np.full(voltage_v.size, Flag.PLAYING, dtype=np.uint32))
    tried = model if knows else StageModel(hysteresis, CreepDynamics(), dynamics)
    left_um = component_residual("dynamics", tried, recording).residual_um
    assert least_um <= np.sqrt(np.mean(left_um**2)) < most_um
