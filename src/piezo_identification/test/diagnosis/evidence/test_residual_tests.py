# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_identification.analysis.gain_over_frequency import spectrum
from piezo_identification.diagnosis.evidence import residual_tests as subject


def test_white_noise_passes_the_test_and_coloured_noise_does_not(noise):
    assert subject.whiteness(noise).passed
    assert not subject.whiteness(lfilter([1.0], [1.0, -0.5], noise)).passed


def test_the_correlation_of_a_first_order_process_is_its_pole(noise):
    test = subject.whiteness(lfilter([1.0], [1.0, -0.8], noise))
    assert test.correlation[:3] == pytest.approx([0.8, 0.64, 0.512], abs=0.03)


def test_what_follows_the_input_is_found_at_its_lag(noise):
    driven = lfilter([1.0], [1.0, -0.9], np.random.default_rng(4).normal(size=noise.size))
    late = noise + 0.5 * np.roll(driven, 7)
    test = subject.input_correlation(late, driven)
    assert test.lags[np.argmax(np.abs(test.correlation))] == 7
    assert not test.passed
    assert subject.input_correlation(noise, driven).passed


def test_the_spectrum_integrates_to_the_power(noise):
    frequency_hz, density = spectrum(noise, 1e-3)
    assert np.trapezoid(density, frequency_hz) == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("quantity", [
    "displacement (um)", "speed (um/s)", "direction", "time (s)",
    "voltage span of the branch (V)", "voltage of the last reversal (V)",
])
def test_the_dependence_that_is_there_is_the_strongest(quantity, noise):
    time_s = np.arange(noise.size) * 1e-3
    generator = np.random.default_rng(0)
    # Ways of random length between random levels.
    turns = np.cumsum(generator.integers(300, 700, 90))
    levels = generator.uniform(0.0, 100.0, turns.size)
    voltage_v = np.interp(np.arange(noise.size), turns, levels)
    displacement_um = lfilter([0.02], [1.0, -0.98], voltage_v)
    span, start = subject._branches(voltage_v)
    driver = {
        "displacement (um)": displacement_um, "time (s)": time_s,
        "speed (um/s)": np.gradient(displacement_um, time_s),
        "direction": np.sign(np.gradient(voltage_v)),
        "voltage span of the branch (V)": span, "voltage of the last reversal (V)": start,
    }[quantity]
    residual = 0.3 * noise + (driver - driver.mean()) / driver.std()
    found = subject.dependences(residual, displacement_um, voltage_v, time_s)
    strongest = max(found, key=lambda dependence: dependence.share)
    assert strongest.quantity == quantity
    assert strongest.share > 0.6


def test_noise_depends_on_nothing(noise):
    dependence = subject.dependence(noise, np.arange(noise.size), "time (s)")
    assert dependence.share < 0.01
    assert np.mean(np.abs(dependence.mean_um) > dependence.band_um) < 0.1
