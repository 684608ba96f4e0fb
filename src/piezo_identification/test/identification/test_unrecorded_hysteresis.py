# SPDX-License-Identifier: BSD-3-Clause
"""Fast records of a stage whose hysteresis was not recorded, of plays in place of relays."""

import numpy as np
import pytest
from scipy.signal import chirp

from piezo_identification.estimators.hysteresis.beside_dynamics import (
    FastLoops,
    hysteresis_beside_dynamics,
)
from piezo_models.linear.dynamics import ElectricVibrationDynamics

PERIOD_S, COUNT = 1e-4, 8000
TRUTH = ElectricVibrationDynamics(4e-4, (3000.0,), (0.05,))
GUESS = ElectricVibrationDynamics(3e-4, (2700.0,), (0.1,))


def voltage_of(kind):
    time_s = np.arange(COUNT) * PERIOD_S
    random = np.random.default_rng(4)
    if kind == "chirp":
        return 40.0 + 30.0 * chirp(time_s, 5.0, time_s[-1], 900.0)
    if kind == "multisine":
        phases = random.uniform(0.0, 2.0 * np.pi, 40)
        tones = 2.0 * np.pi * 20.0 * np.arange(1, 41)
        return 40.0 + 4.0 * np.sin(np.outer(time_s, tones) + phases).sum(axis=1)
    return np.clip(40.0 + 10.0 * random.normal(size=COUNT // 4), 0.0, 80.0).repeat(4)


def error_of(dynamics):
    """Largest relative error of the response up to the mode and beyond."""
    frequency_hz = np.linspace(1.0, 900.0, 60)
    truth = TRUTH.response(frequency_hz)
    return np.abs(dynamics.response(frequency_hz) - truth).max() / np.abs(truth).max()


@pytest.mark.parametrize("kind", ["chirp", "multisine", "noise"])
def test_dynamics_and_hysteresis_are_told_apart_in_one_record(kind, foreign_stage, record):
    stage = foreign_stage((), 4e-4, 3000.0, 0.05)
    recording = record(stage, voltage_of(kind), PERIOD_S, noise_um=0.01)
    loops = FastLoops(
        recording.voltage_v, recording.displacement_um, np.ones((COUNT, 1)), 3000, PERIOD_S)
    hysteresis, dynamics = hysteresis_beside_dynamics([loops], GUESS)
    assert error_of(dynamics) < 3e-3
    inside_v = np.clip(
        40.0 - 25.0 * np.cos(np.linspace(0.0, 20.0, 2000)), *np.quantile(loops.voltage_v, [0, 1]))
    truth_um = stage.hysteresis(inside_v)
    error_um = (hysteresis.simulate(inside_v) - truth_um)[600:]
    assert np.std(error_um) < 0.02 * np.ptp(truth_um)
