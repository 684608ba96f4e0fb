# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_identification.conditioning import sensor_noise as subject


def test_the_noise_floor_is_not_raised_by_slow_structure_or_a_tone(noise):
    time_s = np.arange(noise.size) * 25e-6
    signal = 0.009 * noise + np.sin(30.0 * time_s) + 0.2 * np.sin(2.0 * np.pi * 15e3 * time_s)
    assert subject.noise_floor_um(signal) == pytest.approx(0.009, rel=0.05)


@pytest.mark.parametrize("rows", [8, 12, 16])
def test_few_rows_have_a_noise_floor_too(noise, rows):
    assert 0.0 < subject.noise_floor_um(noise[:rows]) < 5.0


def test_the_noise_is_seen_at_rest_and_between_repeats(noise):
    voltage_v = np.repeat([0.0, 50.0, 20.0, 70.0], 10_000)
    assert subject.noise_from_rest_um(0.009 * noise + voltage_v, voltage_v) == pytest.approx(
        0.009, rel=0.03)
    assert subject.noise_from_rest_um(noise, np.arange(noise.size) * 1.0) is None
    repeated = np.tile(np.sin(np.arange(4000.0)), 10) + 0.009 * noise
    repeated += np.linspace(0.0, 1.0, repeated.size)
    assert subject.noise_from_repeats_um(repeated, 4000) == pytest.approx(0.009, rel=0.03)
    assert subject.noise_from_repeats_um(repeated, 30_000) is None


@pytest.mark.parametrize(("period", "count"), [(4000, 10), (4001, 3), (20_000, 2)])
def test_the_period_is_the_shortest_after_which_the_voltage_repeats(period, count):
    random = np.random.default_rng(period)
    voltage_v = np.tile(random.uniform(-20.0, 120.0, period), count)
    assert subject.repeated_period(voltage_v) == period
    # The last repeat may be cut.
    assert subject.repeated_period(voltage_v[: -period // 3]) == (period if count > 2 else None)
    voltage_v[-5] += 0.01
    assert subject.repeated_period(voltage_v) is None


def test_a_voltage_that_rests_or_goes_on_rising_does_not_repeat():
    assert subject.repeated_period(np.full(1000, 50.0)) is None
    assert subject.repeated_period(np.arange(1000.0)) is None


def test_repeats_tell_the_noise_where_the_sensor_s_own_band_does_not(noise):
    # A tone of every harmonic fills all bands, and the voltage never rests.
    period = 4000
    played = np.tile(np.random.default_rng(0).normal(size=period), 10)
    found = subject.sensor_noise_um(
        played + 0.009 * noise, played, played + 0.009 * noise, subject.repeated_period(played))
    assert found == pytest.approx(0.009, rel=0.03)


def test_a_rest_repeats_and_a_motion_that_is_slow_beside_the_rows_show_the_noise(noise):
    voltage_v = np.random.default_rng(1).normal(size=noise.size)
    assert not subject.shows_noise(voltage_v + 0.01 * noise, voltage_v)
    resting_v = np.append(voltage_v, np.full(1000, voltage_v[-1]))
    assert subject.shows_noise(resting_v + 0.01 * np.resize(noise, resting_v.size), resting_v)
    repeating_v = np.tile(voltage_v[:4000], 10)
    assert subject.shows_noise(repeating_v + 0.01 * noise, repeating_v)
    slow_v = np.convolve(voltage_v, np.hanning(60), mode="same")
    assert subject.shows_noise(slow_v + 0.01 * noise, slow_v)
