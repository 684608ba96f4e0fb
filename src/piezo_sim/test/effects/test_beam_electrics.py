# SPDX-License-Identifier: BSD-3-Clause
"""Converter, jitter, amplifier and line of the plant `beam` against analytic solutions."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.signal import StateSpace, lsim

from piezo_sim.plant.plant_effect import PlantConfigError, Surroundings
from piezo_sim.plant.plant_file import read_plant

PLANT = read_plant("beam")
CONVERTER, JITTER, AMPLIFIER, LINE = PLANT.amplifier
LAG, SAMPLING, SENSOR = PLANT.sensor
PERIOD_S = 2.5e-5
SURROUNDINGS = Surroundings(sample_period_s=PERIOD_S, rest_voltage_v=0.0, seed=4)

unhurried = settings(deadline=None)  # the first example may compile


def played(effect, levels, rest=0.0, surroundings=SURROUNDINGS):
    runner = effect.start(surroundings)
    runner.rest(rest)
    samples = np.array(levels, dtype=float)
    runner.apply(samples)
    return samples


@pytest.mark.parametrize(("effect", "low", "high"), [
    (CONVERTER, -20.0, 120.0), (dataclasses.replace(SENSOR, noise_rms_um=0.0), -50.0, 150.0)])
def test_both_converters_have_the_steps_of_16_bits(effect, low, high):
    step = (high - low) / 65535
    levels = np.linspace(10.0, 10.0 + 20 * step, 2001)
    converted = played(effect, levels)
    assert (converted - low) / step == pytest.approx(np.rint((converted - low) / step), abs=1e-6)
    assert np.diff(np.unique(converted)) == pytest.approx(step, rel=1e-6)
    assert np.abs(converted - levels).max() == pytest.approx(step / 2, rel=0.03)
    assert played(effect, [-1e3, 1e3]) == pytest.approx([low, high])


@pytest.mark.parametrize("effect", [JITTER, SAMPLING], ids=lambda effect: effect.name)
def test_jitter_errs_by_the_slope_times_a_half_normal_time(effect):
    slope = 3e4  # per second
    count = 200_000
    ramp = slope * PERIOD_S * np.arange(count)
    behind_s = (ramp - played(effect, ramp))[1:] / slope
    assert behind_s.min() >= -1e-12
    assert np.sqrt(np.mean(behind_s**2)) == pytest.approx(effect.jitter_rms_s, rel=0.01)
    assert np.mean(behind_s) == pytest.approx(effect.jitter_rms_s * np.sqrt(2 / np.pi), rel=0.01)
    for lag in (1, 2, 40):
        assert abs(np.corrcoef(behind_s[lag:], behind_s[:-lag])[0, 1]) < 5 / np.sqrt(count)


def test_jitter_shows_nothing_at_rest_and_differs_between_both_converters():
    assert np.array_equal(played(JITTER, np.full(1000, 3.0), rest=3.0), np.full(1000, 3.0))
    ramp = np.arange(1000.0)
    assert np.abs(np.corrcoef(ramp - played(JITTER, ramp), ramp - played(SAMPLING, ramp))[0, 1]) < (
        0.2)


def test_small_steps_of_the_amplifier_have_the_mean_of_the_second_order_loop():
    w, zeta = AMPLIFIER.natural_frequency_rad_per_s, AMPLIFIER.damping_ratio
    fine = 400
    time_s = PERIOD_S / fine * np.arange(20 * fine + 1)
    loop = StateSpace([[0.0, 1.0], [-w * w, -2 * zeta * w]], [[0.0], [w * w]], [[1.0, 0.0]], [[0]])
    _, step, _ = lsim(loop, np.ones(time_s.size), time_s)
    means = np.array([np.trapezoid(step[n * fine:(n + 1) * fine + 1], dx=1 / fine)
                      for n in range(20)])
    assert played(AMPLIFIER, np.full(20, 0.1)) == pytest.approx(0.1 * means, abs=1e-6)
    assert played(AMPLIFIER, np.full(400, 0.1))[-1] == pytest.approx(0.1, abs=1e-12)


def test_a_large_step_of_the_amplifier_takes_the_time_of_its_slew_rate():
    slew = dataclasses.replace(AMPLIFIER, slew_rate_v_per_s=1e5)
    ramp_v = played(slew, np.full(100, 100.0))
    assert np.diff(ramp_v[5:35]) == pytest.approx(1e5 * PERIOD_S, rel=1e-6)
    assert ramp_v[-1] == pytest.approx(100.0, abs=1e-6)


@unhurried
@given(arrays(float, 30, elements=st.floats(-20.0, 120.0)))
def test_the_amplifier_never_exceeds_its_slew_rate(voltage_v):
    largest_v = AMPLIFIER.slew_rate_v_per_s * PERIOD_S
    output_v = played(AMPLIFIER, voltage_v)
    # A change of the mean over a sample is at most the slew rate times a period.
    assert np.abs(np.diff(np.append(0.0, output_v))).max() <= largest_v * (1.0 + 1e-9)


def test_the_line_responds_with_tanh_q_over_q():
    # Every frequency at once: the response to one held sample, less the hold and the mean.
    count, charging_s = 2**15, LINE.resistance_ohm * LINE.capacitance_f
    pulse = np.zeros(count)
    pulse[0] = 1.0
    frequency_hz = np.fft.rfftfreq(count, PERIOD_S)[1:2000]
    found = np.fft.rfft(played(LINE, pulse))[1:2000]
    # Aliases of the hold and of the mean, each sin(x) / x, as far as they count.
    expected = np.zeros(frequency_hz.size, dtype=complex)
    for alias in range(-400, 401):
        f = frequency_hz + alias / PERIOD_S
        q = np.sqrt(2j * np.pi * f * charging_s)
        expected += np.sinc(f * PERIOD_S) ** 2 * np.tanh(q) / q
    assert np.abs(found - expected).max() < 2e-4
    slow = frequency_hz < 200.0
    q = np.sqrt(2j * np.pi * frequency_hz[slow] * charging_s)
    assert np.abs(found[slow] - np.tanh(q) / q).max() < 2e-4


def test_the_line_charges_by_the_square_root_of_time_at_first_and_wholly_at_last():
    charging_s = LINE.resistance_ohm * LINE.capacitance_f
    fine = Surroundings(charging_s * 1e-4, 0.0, 1)
    charge = played(LINE, np.ones(400), surroundings=fine)
    middle_s = fine.sample_period_s * (np.arange(400) + 0.5)
    early = slice(20, 200)
    assert charge[early] == pytest.approx(2.0 * np.sqrt(middle_s[early] / charging_s / np.pi),
                                          rel=1e-3)
    assert played(LINE, np.ones(2000))[-1] == pytest.approx(1.0, abs=1e-12)


def test_noise_of_the_sensor_is_9_nm_and_its_bandwidth_5_khz():
    noise_um = played(SENSOR, np.zeros(100_000))
    step_um = 200.0 / 65535
    assert np.std(noise_um) == pytest.approx(np.hypot(0.009, step_um / np.sqrt(12)), rel=0.01)
    time_s = PERIOD_S * np.arange(4000)
    wave = np.exp(2j * np.pi * 5000.0 * time_s)
    heard = played(LAG, wave.real)[2000:] @ wave.conj()[2000:] / 1000.0
    # Straight lines between the samples take a little of the wave before the filter.
    straight = np.sinc(5000.0 * PERIOD_S) ** 2
    assert abs(heard) == pytest.approx(np.sqrt(0.5) * straight, abs=0.005)


@pytest.mark.parametrize(("effect", "change"), [
    (CONVERTER, {"voltage_min_v": 120.0}), (CONVERTER, {"converter_bits": 0}),
    (JITTER, {"jitter_rms_s": -1.0}), (SAMPLING, {"jitter_rms_s": -1.0}),
    (AMPLIFIER, {"natural_frequency_rad_per_s": 0.0}), (AMPLIFIER, {"damping_ratio": 0.0}),
    (AMPLIFIER, {"slew_rate_v_per_s": 0.0}), (LINE, {"resistance_ohm": 0.0}),
    (LINE, {"capacitance_f": -1.0}),
])
def test_impossible_parameters_are_refused(effect, change):
    with pytest.raises(PlantConfigError, match=f"{effect.name}: .* must"):
        dataclasses.replace(effect, **change)
