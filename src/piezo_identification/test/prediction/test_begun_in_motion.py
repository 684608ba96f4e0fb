# SPDX-License-Identifier: BSD-3-Clause
"""A recording whose first row finds a mode ringing that rings for longer than the recording."""

import numpy as np
from scipy.signal import cont2discrete, lfilter

from piezo_identification.prediction import predict
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder import recording_of

PERIOD_S, SAMPLES, NOISE_UM = 2e-3, 4000, 1e-3
MODE = 180.0, 0.002


def test_what_rings_from_before_is_no_error():
    generator, (w, z) = np.random.default_rng(1), MODE
    voltage_v = 10.0 * generator.normal(size=SAMPLES)
    held = cont2discrete(([w * w], [1.0, 2.0 * z * w, w * w]), PERIOD_S, "zoh")
    measured_um = lfilter(held[0][0], held[1], 0.1 * voltage_v) + NOISE_UM * generator.normal(
        size=SAMPLES)
    model = StageModel(
        PreisachModel(-100.0, 100.0, np.zeros((1, 1)), -10.0, np.array([0.1])), CreepDynamics(),
        ElectricVibrationDynamics(0.0, (w,), (z,)))
    begun = slice(3300, None)
    prediction = predict(model, recording_of({
        "time_s": PERIOD_S * np.arange(SAMPLES - 3300), "voltage_v": voltage_v[begun],
        "displacement_um": measured_um[begun]}))
    assert np.std(prediction.measured_um - prediction.simulated_um) < 1.1 * NOISE_UM
