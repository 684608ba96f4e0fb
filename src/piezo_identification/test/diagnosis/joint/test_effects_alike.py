# SPDX-License-Identifier: BSD-3-Clause
"""Two effects that a recording cannot tell apart are as probable, though one has a number more."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

PERIOD_S, SAMPLES, NOISE_UM, LAG_S = 1e-3, 3000, 2e-3, 2e-4
MODE = (400.0, 0.1)
MODEL = StageModel(
    PreisachModel(-100.0, 100.0, np.zeros((1, 1)), -10.0, np.array([0.1])), CreepDynamics(),
    ElectricVibrationDynamics(0.0, MODE[:1], MODE[1:]))


def through(numerator, denominator, signal):
    discrete = cont2discrete((numerator, denominator), PERIOD_S, "bilinear")
    return lfilter(discrete[0][0], discrete[1], signal)


def scan():
    """Record two slow tones with a lag of the sensor: it differs from a delay by 1 nm there."""
    generator, time_s = np.random.default_rng(1), PERIOD_S * np.arange(SAMPLES)
    voltage_v = 25.0 * (np.sin(2.0 * np.pi * 7.0 * time_s) + np.sin(2.0 * np.pi * 18.0 * time_s))
    w, z = MODE
    zoh = cont2discrete(([w * w], [1.0, 2.0 * z * w, w * w]), PERIOD_S, "zoh")
    displacement_um = through(
        [1.0], [LAG_S, 1.0], lfilter(zoh[0][0], zoh[1], 0.1 * voltage_v))
    return Recording(
        path="scan", sample_rate_hz=1.0 / PERIOD_S, sample_index=np.arange(SAMPLES),
        sample_periods_s=np.full(SAMPLES, PERIOD_S), voltage_v=voltage_v,
        displacement_um=displacement_um + NOISE_UM * generator.normal(size=SAMPLES),
        flags=np.full(SAMPLES, Flag.PLAYING, dtype=np.uint32))


def test_a_lag_and_a_delay_of_one_phase_are_as_probable():
    diagnosis = diagnose(MODEL, [scan()])
    shares = diagnosis.probabilities
    assert diagnosis.verdict == "explained"
    assert 1.0 / 3.0 < shares["delay"] / shares["sensor_lag"] < 3.0
    assert sum(shares.values()) == pytest.approx(1.0)
    assert {"delay", "sensor_lag"} <= {
        *(entry["name"] for entry in diagnosis.effects), *diagnosis.not_decidable}
