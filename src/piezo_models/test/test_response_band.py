# SPDX-License-Identifier: BSD-3-Clause
"""The response of a model is drawn with the band of its parameters' standard deviations."""

import numpy as np
import pytest

from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_pictures import response_deviations

LAG_S, DEVIATION_S = 1e-3, 2e-5
MODEL = StageModel(PreisachModel(0.0, 100.0, np.array([[0.01]])), CreepDynamics(),
                   ElectricVibrationDynamics(LAG_S))
IDENTIFIED = IdentifiedModel(
    MODEL, (0.0, 100.0), uncertainties={"dynamics": {"time_constant_s": DEVIATION_S}})


def test_deviations_are_those_of_a_lag():
    frequency_hz = np.array([10.0, 100.0, 1000.0])
    magnitude, phase_rad = response_deviations(IDENTIFIED, frequency_hz)
    moved = -2j * np.pi * frequency_hz * DEVIATION_S / (1.0 + 2j * np.pi * frequency_hz * LAG_S)
    assert magnitude == pytest.approx(np.abs(moved.real), rel=1e-3)
    assert phase_rad == pytest.approx(np.abs(moved.imag), rel=1e-3)


def test_gain_and_phase_have_a_band_each():
    gain, phase = IDENTIFIED.bode().axes
    assert len(gain.lines) == len(phase.lines) == 1
    assert len(gain.collections) == len(phase.collections) == 1
