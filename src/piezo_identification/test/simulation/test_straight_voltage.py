# SPDX-License-Identifier: BSD-3-Clause
"""A voltage that is straight between the rows of a recording, beside fine simulations of others."""

import control
import numpy as np
import pytest
from made_by_scipy import logged

from piezo_identification.conditioning.row_alignment import may_be_straight, with_straight_voltage
from piezo_identification.prediction.row_reading import all_as_identified
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

PERIOD_S, FINE, GAIN_UM_PER_V = 1e-3, 40, 2.0
STAGE = StageModel(
    PreisachModel.line(-10.0, 10.0, GAIN_UM_PER_V, -10.0 * GAIN_UM_PER_V),
    CreepDynamics((3.0,), (3.3,)),
    ElectricVibrationDynamics(2e-4, (2500.0,), (0.02,)))


@pytest.fixture(scope="module")
def recording():
    """A generator's sine, read by a logger that reads voltage and displacement together."""
    time_s = PERIOD_S * np.arange(2000)
    voltage_v = 5.0 * np.sin(2.0 * np.pi * 3.0 * np.maximum(time_s - 0.02, 0.0))
    fine_s = PERIOD_S / FINE * np.arange(FINE * (time_s.size - 1) + 1)
    driven_um = GAIN_UM_PER_V * np.interp(fine_s, time_s, voltage_v)
    moved_um = control.forced_response(STAGE.linear(), fine_s, driven_um).outputs[::FINE]
    return logged(voltage_v, moved_um, PERIOD_S)


def test_a_straight_voltage_is_answered_as_in_continuous_time(recording):
    straight = SimulatedRecording(STAGE, with_straight_voltage(recording))
    assert straight.time_s == pytest.approx(recording.time_s)
    assert straight.simulate() == pytest.approx(recording.displacement_um, abs=5e-4)
    held = SimulatedRecording(STAGE, recording)
    assert np.std(held.simulate() - recording.displacement_um) > 0.05


def test_only_a_voltage_that_moves_in_most_rows_may_be_straight(recording):
    assert may_be_straight(recording)
    assert not may_be_straight(with_straight_voltage(recording))
    steps_v = np.repeat([0.0, 5.0, 2.0, 8.0], 500)
    assert not may_be_straight(logged(steps_v, steps_v))


@pytest.mark.parametrize("is_straight", [True, False])
def test_a_further_recording_is_read_so_if_one_of_the_identification_was(recording, is_straight):
    row = {"read_at_samples": 0.0, "standard_deviation_s": 0.0}
    rows = {"hysteresis": {**row, "is_straight": True} if is_straight else row}
    identified = IdentifiedModel(STAGE, (-10.0, 10.0), rows=rows)
    (read,), sentences = all_as_identified(identified, [recording])
    error_um = SimulatedRecording(STAGE, read).error_um()
    assert (error_um < 1e-3) == is_straight
    assert ("straight between the rows" in " ".join(sentences)) == is_straight
