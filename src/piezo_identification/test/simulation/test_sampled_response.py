# SPDX-License-Identifier: BSD-3-Clause
"""Responses at the samples, beside those of a stage that is sampled a hundred times as finely."""

import numpy as np
import pytest

from piezo_identification.simulation.sampled_response import (
    SampledSystem,
    behind_lags,
    leading_lags,
    mean_zoh,
)
from piezo_models.effects.backlash import Backlash
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.linear.dynamics import simulate_linear, zoh

PERIOD_S, FINE = 1e-3, 100


@pytest.fixture(scope="module")
def levels_um():
    return np.repeat(np.random.default_rng(0).normal(size=20), 15)


def finely(system, levels_um):
    """Response at a hundred instants of each sample period, from equilibrium."""
    return SampledSystem(system, PERIOD_S / FINE, 1).response(np.repeat(levels_um, FINE))


@pytest.mark.parametrize("count", [2, 7, 40])
def test_the_mean_of_held_periods_is_that_of_the_samples_in_them(plant, count):
    system = plant.linear()
    held = np.random.default_rng(0).normal(size=50)
    samples = simulate_linear(zoh(system, 25e-6), np.repeat(held, count))
    means = simulate_linear(mean_zoh(system, count * 25e-6, count), held)
    np.testing.assert_allclose(means, samples.reshape(-1, count).mean(axis=1), atol=1e-9)


@pytest.mark.parametrize(("samples", "delay_s"), [(1, 0.0), (1, 2.67e-3), (1, -0.4e-3), (10, 0.0)])
def test_the_response_over_frequency_is_that_of_a_periodic_input(
        plant, levels_um, samples, delay_s):
    sampled = SampledSystem(plant.dynamics.state_space(), PERIOD_S, samples, delay_s)
    period_um = sampled.response(np.tile(levels_um, 3))[levels_um.size : 2 * levels_um.size]
    expected = np.fft.rfft(period_um) / np.fft.rfft(levels_um)
    found = sampled.response_over(np.fft.rfftfreq(levels_um.size))
    shown = np.abs(np.fft.rfft(levels_um)) > 1e-3
    np.testing.assert_allclose(found[shown], expected[shown], atol=1e-6)


@pytest.mark.parametrize("delay_s", [0.0, 0.13e-3, 1e-3, 2.67e-3, 1.0])
def test_a_delay_is_exact_whatever_part_of_a_sample_it_is(plant, levels_um, delay_s):
    system = plant.linear()
    late = round(delay_s / PERIOD_S * FINE)
    fine = finely(system, levels_um)
    before = np.full(min(late, fine.size), fine[0])
    expected = np.concatenate([before, fine[: fine.size - before.size]])[::FINE]
    np.testing.assert_allclose(
        SampledSystem(system, PERIOD_S, 1, delay_s).response(levels_um), expected, atol=1e-9)


@pytest.mark.parametrize("read_at", [0.37, 1.0, 1.4])
def test_a_reading_later_than_the_input_is_exact_and_the_last_input_goes_on(
        plant, levels_um, read_at):
    held_um = np.append(levels_um, [levels_um[-1]] * 2)
    expected = finely(plant.linear(), held_um)[round(read_at * FINE) :: FINE][: levels_um.size]
    sampled = SampledSystem(plant.linear(), PERIOD_S, 1, -read_at * PERIOD_S)
    np.testing.assert_allclose(sampled.response(levels_um), expected, atol=1e-9)


def test_a_lag_of_the_sensor_is_exact_between_the_samples(plant, levels_um):
    lag = SensorLag(0.2e-3, 0.25)
    system, delay_s = behind_lags(plant.linear(), (lag,))
    assert delay_s == 0.0
    expected = lag.apply(finely(plant.linear(), levels_um), PERIOD_S / FINE)[::FINE]
    np.testing.assert_allclose(
        SampledSystem(system, PERIOD_S, 1).response(levels_um), expected, atol=2e-4)


def test_lags_behind_something_bent_act_on_the_samples():
    lags = Delay(1e-4), SensorLag(1e-4)
    assert leading_lags(lags, 1) == (lags, ())
    assert leading_lags((Backlash(0.1), *lags), 1) == ((), (Backlash(0.1), *lags))
    assert leading_lags((lags[1], Backlash(0.1), lags[0]), 1) == (
        (lags[1],), (Backlash(0.1), lags[0]))
    assert leading_lags(lags, 40) == ((), lags)
