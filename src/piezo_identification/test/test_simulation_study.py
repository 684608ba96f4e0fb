# SPDX-License-Identifier: BSD-3-Clause
"""The simulation study of thesis 4.6: its plant, sampling and noise of 0.07 um."""

import numpy as np
import pytest

from piezo_identification.estimators.creep.square_wave_creep import estimate_creep
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

NOISE_UM = 0.07
CREEP = CreepDynamics((0.02, 10.0), (0.12, 15.0))
DYNAMICS = ElectricVibrationDynamics(0.001, (3000.0,), (0.1,))
SEEDS = [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))]


@pytest.fixture(scope="module")
def study():
    alpha, beta = np.indices((100, 100)) * 0.05 + 0.025
    density = 2.0 * np.tril(0.1 + 0.05 * (alpha + beta))
    return StageModel(PreisachModel(0.0, 5.0, density, 0.0), CREEP, DYNAMICS)


@pytest.fixture(scope="module")
def record(study):
    """Return a square wave over the whole range; the seed draws the noise."""
    clean_um = {}

    def draw(period_s, sample_period_s, periods, seed):
        half = round(0.5 * period_s / sample_period_s)
        voltage_v = np.tile(np.repeat([5.0, 0.0], half), periods)
        case = (period_s, periods)
        if case not in clean_um:
            clean_um[case] = study.simulate(voltage_v, sample_period_s)
        samples = voltage_v.size
        noise_um = NOISE_UM * np.random.default_rng(seed).normal(size=samples)
        return Recording(
            "square wave", 1.0 / sample_period_s, np.arange(samples),
            np.full(samples, sample_period_s), voltage_v, clean_um[case] + noise_um,
            np.full(samples, Flag.PLAYING, dtype=np.uint32))
    return draw


def flat(values):
    return np.concatenate([np.ravel(value) for value in values])


@pytest.mark.parametrize("seed", SEEDS)
def test_the_slow_creep_pair_is_within_a_thousandth(record, seed):
    estimate = estimate_creep(record(200.0, 0.02, 2, seed), DYNAMICS)
    assert str(estimate.order) == "2"
    assert estimate.model.poles_rad_per_s[0] == pytest.approx(0.02, rel=1e-3)
    assert estimate.model.zeros_rad_per_s[0] == pytest.approx(0.12, rel=1e-3)
    # 20 ms hardly show the fast pair.
    assert estimate.model.poles_rad_per_s[1] == pytest.approx(10.0, rel=0.1)


@pytest.mark.long  # a stage with two modes is asked for in test_dynamics_estimator.py
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_lag_mode_and_damping_are_as_near_as_asked(record, seed):
    estimate = estimate_dynamics(record(0.1, 1e-4, 100, seed), CREEP)
    assert str(estimate.order) == "1"
    assert estimate.model.time_constant_s == pytest.approx(0.001, rel=2e-3)
    assert estimate.model.mode_frequencies_rad_per_s == pytest.approx((3000.0,), rel=5e-4)
    assert estimate.model.damping_ratios == pytest.approx((0.1,), rel=1e-2)


def test_standard_deviations_of_the_creep_are_those_of_repeated_draws(record):
    normalised = []
    for seed in range(24):
        estimate = estimate_creep(record(200.0, 0.02, 1, seed), DYNAMICS, pair_count=2)
        error = flat(vars(estimate.model).values()) - flat(vars(CREEP).values())
        normalised.append(error / flat(estimate.standard_deviations.values()))
    # The spread of a spread over 24 draws is a seventh; the fast pair is not quite linear.
    assert np.sqrt(np.mean(np.square(normalised), axis=0)) == pytest.approx(1.0, abs=0.5)


@pytest.mark.long
def test_standard_deviations_of_the_dynamics_are_those_of_repeated_draws(record):
    normalised = []
    for seed in range(30):
        estimate = estimate_dynamics(record(0.1, 1e-4, 6, seed), CREEP, mode_count=1)
        error = flat(vars(estimate.model).values()) - flat(vars(DYNAMICS).values())
        normalised.append(error / flat(estimate.standard_deviations.values()))
    assert np.sqrt(np.mean(np.square(normalised), axis=0)) == pytest.approx(1.0, abs=0.4)


def test_means_over_a_sample_are_judged_by_their_own_noise(record):
    """Averaging four samples neither biases nor changes what is known of the slow pair."""
    fine = record(200.0, 0.02, 1, 5)
    coarse = Recording(
        "means", fine.sample_rate_hz, fine.sample_index[::4], np.full(fine.time_s.size // 4, 0.08),
        fine.voltage_v[::4], fine.displacement_um.reshape(-1, 4).mean(axis=1), fine.flags[::4])
    by_fine, by_coarse = (
        estimate_creep(recording, DYNAMICS, pair_count=2) for recording in (fine, coarse))
    for name in ("poles_rad_per_s", "zeros_rad_per_s"):
        known = by_fine.standard_deviations[name][0]
        assert by_coarse.standard_deviations[name][0] == pytest.approx(known, rel=0.25)
        difference = getattr(by_coarse.model, name)[0] - getattr(by_fine.model, name)[0]
        assert abs(difference) < 1.5 * known


def test_the_order_table_shows_why_two_pairs(record):
    lines = estimate_creep(record(200.0, 0.02, 1, 1), DYNAMICS).order_table().splitlines()
    assert [line.split()[0] for line in lines[:4]] == ["order", "0", "1", "2"]
    assert lines[3].endswith("<- least information")
    asked = estimate_creep(record(200.0, 0.02, 1, 1), DYNAMICS, pair_count=1).order_table()
    assert asked.splitlines()[2].endswith("<- given")
