# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_identification.relay import (
    model_ultimate_frequency_hz,
    relay_feedback,
    ultimate_frequency_hz,
)
from piezo_models.linear import CreepDynamics, ElectricVibrationDynamics, zoh
from piezo_recorder.reader import Recording
from piezo_recorder.sample_block import Flag

SAMPLE_PERIOD_S = 25e-6


def recorded(voltage_v):
    samples = voltage_v.size
    return Recording(
        "relay", 1.0 / SAMPLE_PERIOD_S, np.arange(samples), np.full(samples, SAMPLE_PERIOD_S),
        voltage_v, np.zeros(samples), np.full(samples, Flag.PLAYING, dtype=np.uint32))


class LinearStage:
    """Answers like a stage backend, sample by sample."""

    def __init__(self, dynamics):
        self.system = zoh(dynamics.state_space(), SAMPLE_PERIOD_S)
        self.state = np.zeros((self.system.nstates, 1))

    def exchange(self, voltage_v):
        measured_um = self.system.C @ self.state
        self.state = self.system.A @ self.state + self.system.B * voltage_v
        return measured_um.ravel()


def test_the_relay_oscillates_where_the_phase_is_minus_180_degrees():
    # Well damped modes, so that the relay's harmonics hardly come back.
    dynamics = ElectricVibrationDynamics(0.0005, (3000.0, 5000.0), (0.5, 0.5))
    voltage_v, displacement_um = relay_feedback(
        LinearStage(dynamics).exchange, 0.0, 10.0, 5.0, 8000)
    measured_hz = ultimate_frequency_hz(recorded(voltage_v))
    model_hz = model_ultimate_frequency_hz(dynamics.response, 1.5 * SAMPLE_PERIOD_S)
    assert measured_hz == pytest.approx(model_hz, rel=0.02)
    assert displacement_um[4000:].min() < 5.0 < displacement_um[4000:].max()


def test_the_ultimate_frequency_of_three_equal_lags_is_known():
    """Three lags of tau reach -180 degrees at sqrt(3) / tau."""
    def response(frequency_hz):
        return 1.0 / (1.0 + 2j * np.pi * frequency_hz * 0.01) ** 3

    assert model_ultimate_frequency_hz(response) == pytest.approx(
        np.sqrt(3.0) / 0.01 / (2.0 * np.pi), rel=1e-9)


def test_a_model_whose_phase_stays_above_has_none():
    with pytest.raises(ValueError, match="does not make it oscillate"):
        model_ultimate_frequency_hz(CreepDynamics((0.1,), (0.2,)).response)


@pytest.mark.parametrize(("voltage_v", "message"), [
    (np.sin(np.arange(4000) * 0.1), "more than two voltages"),
    (np.repeat([0.0, 10.0], 2000), "does not oscillate for 8 cycles"),
    (np.concatenate([np.tile(np.repeat([0.0, 10.0], 40), 8),
                     np.tile(np.repeat([0.0, 10.0], 200), 4)]), "does not oscillate steadily"),
])
def test_recordings_that_are_no_steady_relay_oscillation_are_refused(voltage_v, message):
    with pytest.raises(ValueError, match=message):
        ultimate_frequency_hz(recorded(voltage_v))
