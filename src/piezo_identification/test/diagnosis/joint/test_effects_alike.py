# SPDX-License-Identifier: BSD-3-Clause
"""Two effects that a recording cannot tell apart are as probable, though one has a number more."""

import numpy as np
import pytest
from made_by_scipy import behind_mode, line_model, logged
from scipy.signal import cont2discrete, lfilter

from piezo_identification.diagnosis.diagnose import diagnose

PERIOD_S, SAMPLES, NOISE_UM, LAG_S = 1e-3, 3000, 2e-3, 2e-4
MODE = (400.0, 0.1)
MODEL = line_model(*MODE)


def scan():
    """Record two slow tones with a lag of the sensor: it differs from a delay by 1 nm there."""
    generator, time_s = np.random.default_rng(1), PERIOD_S * np.arange(SAMPLES)
    voltage_v = 25.0 * (np.sin(2.0 * np.pi * 7.0 * time_s) + np.sin(2.0 * np.pi * 18.0 * time_s))
    (numerator,), denominator, _ = cont2discrete(([1.0], [LAG_S, 1.0]), PERIOD_S, "bilinear")
    displacement_um = lfilter(numerator, denominator, behind_mode(0.1 * voltage_v, *MODE))
    noise_um = NOISE_UM * generator.normal(size=SAMPLES)
    return logged(voltage_v, displacement_um + noise_um)


@pytest.mark.usefixtures("likely_effects")
def test_a_lag_and_a_delay_of_one_phase_are_as_probable():
    diagnosis = diagnose(MODEL, [scan()])
    shares = diagnosis.probabilities
    assert diagnosis.verdict == "explained"
    assert 1.0 / 3.0 < shares["delay"] / shares["sensor_lag"] < 3.0
    assert sum(shares.values()) == pytest.approx(1.0)
    assert {"delay", "sensor_lag"} <= {
        *(entry["name"] for entry in diagnosis.effects), *diagnosis.not_decidable}
