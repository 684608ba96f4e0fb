# SPDX-License-Identifier: BSD-3-Clause
"""Creep with a power of time, in closed form, is described by a law of two numbers."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from piezo_identification.estimators.creep.power_law import POWER_LAW, RATIO, continued
from piezo_identification.estimators.creep.slow_creep import estimate_slow_creep
from piezo_identification.estimators.creep.square_wave_creep import estimate_creep
from piezo_models.linear.dynamics import ElectricVibrationDynamics
from piezo_recorder import recording_of

PERIOD_S, HELD, NOISE_UM, EXPONENT, PART = 0.04, 1000, 0.002, 0.12, 0.05
LEVELS_V = (20.0, 80.0, 20.0, 80.0, 20.0)
MODE_RAD_PER_S = 3000.0


def crept(time_s):
    """Creep of a unit step a time after it, with a power of time."""
    return PART * time_s**EXPONENT


@pytest.fixture(scope="module")
def recording(recorded):
    """Steps of a stage without hysteresis that rested at its first level for long."""
    voltage_v = np.repeat(LEVELS_V, HELD)
    time_s = np.arange(voltage_v.size) * PERIOD_S
    displacement_um = 0.1 * voltage_v
    for number, (before, after) in enumerate(zip(LEVELS_V[:-1], LEVELS_V[1:], strict=True), 1):
        since = np.maximum(time_s - HELD * number * PERIOD_S, 0.0)
        displacement_um += 0.1 * (after - before) * np.where(since > 0.0, crept(since), 0.0)
    return recorded("power of time", voltage_v, displacement_um, PERIOD_S, NOISE_UM)


@pytest.fixture(scope="module", params=[
    estimate_creep, pytest.param(estimate_slow_creep, marks=pytest.mark.long)])
def estimate(request, recording):
    mode = ElectricVibrationDynamics(0.0, (MODE_RAD_PER_S,), (0.02,))
    return request.param(recording, mode)


def test_power_of_time_is_chosen_as_a_law(estimate):
    assert estimate.order == POWER_LAW


def test_law_predicts_creep_much_faster_and_slower_than_the_rows(estimate):
    """It is right to a few percent from a tenth of the first row to ten times the last."""
    zeros, poles = (np.array(getattr(estimate.model, name))
                    for name in ("zeros_rad_per_s", "poles_rad_per_s"))
    time_s = np.geomspace(0.1 * PERIOD_S, 10.0 * HELD * PERIOD_S, 50)
    # Step response of the product of (s + z) / (s + p), by its residues at its poles.
    parts = np.array([np.prod(zeros - pole) / np.prod(np.delete(poles, place) - pole) / -pole
                      for place, pole in enumerate(poles)])
    step = np.prod(zeros / poles) + np.exp(-np.outer(time_s, poles)) @ parts
    change = (step - step[0]) / step[25]
    expected = (crept(time_s) - crept(time_s[0])) / (1.0 + crept(time_s[25]))
    assert change == pytest.approx(expected, abs=0.03 * expected[-1])


def test_law_ends_below_the_modes(estimate):
    fastest = max(estimate.model.poles_rad_per_s)
    assert 0.2 * MODE_RAD_PER_S / RATIO < fastest < 0.2 * MODE_RAD_PER_S


def test_deviations_belong_to_the_zeros(estimate):
    """The rates are chosen, not estimated."""
    deviations = estimate.standard_deviations
    assert not any(deviations["poles_rad_per_s"])
    assert all(each > 0.0 for each in deviations["zeros_rad_per_s"])


def test_law_goes_on_into_the_band_of_fast_recordings_if_no_mode_is_known(recording):
    found = estimate_creep(recording, highest_rad_per_s=MODE_RAD_PER_S)
    assert found.order == POWER_LAW
    assert max(found.model.poles_rad_per_s) > 0.2 * MODE_RAD_PER_S / RATIO


def test_a_law_whose_gains_increase_with_the_rates_leaves_an_immediate_gain():
    rates = np.log(0.1 * RATIO ** np.arange(5.0))
    for exponent in (-0.2, 0.0, 0.3, 0.8):
        gains = np.log(0.02) + exponent * (rates - rates[0])
        point, free = continued(np.concatenate([rates, gains]), 1e4)
        wider, all_gains = np.split(point, 2)
        assert np.isfinite(point).all() and free.shape == (point.size, 2)
        np.testing.assert_allclose(np.diff(wider), np.log(RATIO))
        # Relative to the slow ones, the immediate gain is what the faster ones have left.
        faster = np.exp(all_gains[rates.size :]).sum()
        np.testing.assert_allclose(np.exp(all_gains[: rates.size] - gains), 1.0 + faster)
        assert faster <= 1.0 + 1e-9


def test_ringing_that_slow_rows_alias_is_no_creep():
    rate_rad_per_s, damping, period_s = 646.0, 0.008, 0.01
    [numerator], denominator, _ = cont2discrete(
        ([rate_rad_per_s**2], [1.0, 2.0 * damping * rate_rad_per_s, rate_rad_per_s**2]),
        period_s, "zoh")
    voltage_v = np.repeat([-5.0, 5.0, 5.0, 0.0], 750)
    displacement_um = lfilter(numerator, denominator, np.append(np.full(2000, -5.0), voltage_v))
    noise_um = 1e-4 * np.random.default_rng(0).normal(size=voltage_v.size)
    estimate = estimate_slow_creep([recording_of({
        "time_s": period_s * np.arange(voltage_v.size), "voltage_v": voltage_v,
        "displacement_um": displacement_um[2000:] + noise_um})])
    assert not estimate.model.poles_rad_per_s
