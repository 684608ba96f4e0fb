# SPDX-License-Identifier: BSD-3-Clause
"""Creep within the half period of a fast square wave does not bend lag and modes."""

import sys

import numpy as np
import pytest
from scipy import signal

from piezo_identification.estimators.dynamics.fast_creep import (
    best_free_fit,
    fast_creep,
    joined_creep,
    sought_rates,
)
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics, mean_period
from piezo_identification.estimators.dynamics.fast_record import FastRecord, FreeFit, independent
from piezo_identification.estimators.poles.pole_responses import HeldInput
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

RATE_HZ = 10_000.0
PERIODS, PERIOD_SAMPLES = 10, 2000
LAG_S, MODES_HZ, DAMPINGS, PARTS = 4e-4, (620.0, 1450.0), (0.02, 0.015), (0.94, 0.06)
OVERSAMPLED = 10
NOISE_UM = 2e-3
DECADES = tuple(np.geomspace(1.0, 100.0, 7))


def recording(creep_part, creep_rates=DECADES, modes=2):
    """A stage in closed form but for a tenth of a sample, which creeps alike at every rate."""
    step_s = 1.0 / (OVERSAMPLED * RATE_HZ)
    level = np.tile(np.repeat([1.0, 0.0], PERIOD_SAMPLES // 2), PERIODS)
    moved = np.repeat(level, OVERSAMPLED)

    def passed(transfer, values):
        numerator, denominator, _ = signal.cont2discrete(transfer, step_s)
        return signal.lfilter(numerator.ravel(), denominator, values)

    crept = moved + sum(
        creep_part * passed(([rate], [1.0, rate]), moved) for rate in creep_rates)
    lagged = passed(([1.0], [LAG_S, 1.0]), crept)
    rates = 2.0 * np.pi * np.array(MODES_HZ)
    displacement_um = 3.0 / sum(PARTS[:modes]) * sum(
        passed(([part * rate**2], [1.0, 2.0 * damping * rate, rate**2]), lagged)
        for rate, damping, part in list(zip(rates, DAMPINGS, PARTS, strict=True))[:modes]
    )[::OVERSAMPLED]
    noise_um = NOISE_UM * np.random.default_rng(1).normal(size=level.size)
    return Recording("closed form", RATE_HZ, np.arange(level.size),
                     np.full(level.size, 1.0 / RATE_HZ), 35.0 + 10.0 * level,
                     displacement_um + noise_um,
                     np.full(level.size, Flag.PLAYING, dtype=np.uint32))


def test_a_decay_that_is_over_before_the_record_begins_takes_no_part():
    begun = np.exp(-np.linspace(0.0, 3.0, 50))
    with_nothing = independent(np.column_stack([np.ones(50), begun, np.zeros(50)]))
    assert with_nothing == pytest.approx(independent(np.column_stack([np.ones(50), begun])))


def test_columns_are_orthonormal_to_those_beside_however_alike():
    time = np.linspace(0.0, 1.0, 500)
    beside = independent(np.cos(np.pi * np.outer(time, np.arange(60))))
    decays = np.exp(-np.outer(time, [0.1, 0.1001, 3.0, 80.0]))
    every = np.column_stack([beside, independent(decays, beside)])
    np.testing.assert_allclose(every.T @ every, np.eye(every.shape[1]), atol=1e-12)
    np.testing.assert_allclose(decays - every @ (every.T @ decays), 0.0, atol=1e-7)
    over = mean_period(recording(0.0), CreepDynamics((1.0, 2e3), (1.1, 2.1e3)))
    assert np.isfinite(over.fit_free(np.log([LAG_S, 3900.0, 0.02]), 0.0, 2).cost)


@pytest.mark.long
def test_dynamics_behind_creep_of_every_decade_are_those_without_it():
    estimate = estimate_dynamics(recording(creep_part=0.01), CreepDynamics())
    assert estimate.model.time_constant_s == pytest.approx(LAG_S, rel=0.01)
    modes = (*estimate.model.mode_frequencies_rad_per_s,
             *(mode.frequency_rad_per_s for mode in estimate.effects
               if mode.place == "modes"))
    assert sorted(modes) == pytest.approx(2.0 * np.pi * np.array(MODES_HZ), rel=1e-3)
    assert max(estimate.model.damping_ratios) < 0.03
    assert abs(estimate.delay_s) < 0.1 / RATE_HZ
    assert estimate.residual_rms < 1.2 * NOISE_UM / np.sqrt(PERIODS - 3)
    rates = np.array(estimate.creep.poles_rad_per_s)
    assert rates.size and np.all(rates > 1.0) and np.all(rates < 800.0)
    assert len(estimate.creep_deviations["zeros_rad_per_s"]) == rates.size


def test_no_creep_is_found_where_there_is_none():
    assert fast_creep(
        lambda creep: mean_period(recording(creep_part=0.0), creep), CreepDynamics()) is None


def test_creep_that_explains_as_much_as_free_poles_need_not_pay_for_its_numbers():
    """Of one rate, between those that are tried: two stand for it, and no pole of the fit does."""
    stage = recording(creep_part=0.01, creep_rates=(30.0,), modes=1)
    found = fast_creep(lambda creep: mean_period(stage, creep), CreepDynamics())
    assert found is not None
    model, _ = found
    below, above = model.poles_rad_per_s
    assert below < 30.0 < above
    response = model.response(np.array([1.0, 5.0, 20.0]))
    truth = CreepDynamics((30.0,), (30.3,)).response(np.array([1.0, 5.0, 20.0]))
    # Creep counts relative to what follows at once.
    np.testing.assert_allclose(response / response[-1], truth / truth[-1], atol=1e-3)


@pytest.mark.parametrize("rings_at, known_rate, first, last", [
    (40.0, (), 0.5, 8.0), (400.0, (), 0.5, 50.0), (400.0, (4.0,), 12.0, 50.0),
    (40.0, (4.0,), None, None)])
def test_creep_is_sought_above_the_known_one_and_below_what_rings_and_what_rows_show(
        rings_at, known_rate, first, last):
    """Rows of 0.02 s over 2 s; half the sample rate is 157 rad/s."""
    record = FastRecord(HeldInput(np.zeros(100), 0.02, False), np.arange(90), np.arange(90.0),
                        np.ones((90, 1)))
    poles = np.array([-1.0, rings_at * (-0.28 + 0.96j), rings_at * (-0.28 - 0.96j)])
    free = FreeFit(np.zeros(3), 0.0, np.zeros(90), poles, np.ones(3, dtype=complex))
    creep = CreepDynamics(known_rate, tuple(1.1 * rate for rate in known_rate))
    rates = sought_rates(record, free, creep)
    assert (rates[0], rates[-1]) == pytest.approx((first, last)) if first else not rates.size


def test_creep_of_two_in_succession_is_the_product_of_their_responses():
    first, second = CreepDynamics((0.1, 3.0), (0.11, 3.3)), CreepDynamics((1.0,), (1.2,))
    frequency_hz = np.geomspace(1e-3, 10.0, 20)
    np.testing.assert_allclose(
        joined_creep(first, second).response(frequency_hz),
        first.response(frequency_hz) * second.response(frequency_hz))


@pytest.mark.long
def test_creep_is_sought_until_it_leaves_no_slow_pole_in_the_dynamics(monkeypatch):
    """The poles that stood for creep had bent the dynamics beside which it was sought first."""
    monkeypatch.setattr(sys.modules[__name__], "NOISE_UM", 5e-4)
    stage = recording(creep_part=0.004, creep_rates=np.geomspace(3.0, 600.0, 10))
    found = fast_creep(lambda creep: mean_period(stage, creep), CreepDynamics())
    assert found is not None
    left = best_free_fit(mean_period(stage, found[0])).poles
    assert left.size == 1 + 2 * len(MODES_HZ)
    assert np.abs(left).min() == pytest.approx(1.0 / LAG_S, rel=0.01)
