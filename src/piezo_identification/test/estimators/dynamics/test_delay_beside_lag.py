# SPDX-License-Identifier: BSD-3-Clause
"""A slow stage that rings for long behind a delay of a part of a sample period, and has no lag."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from independent_stage import IndependentStage, square_wave_v

from piezo_identification.estimators.dynamics.fast_dynamics import ModeOrder
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics, mean_period
from piezo_identification.estimators.dynamics.fast_record import FastFit
from piezo_identification.estimators.dynamics.fit_deviations import delay_deviation, fit_covariance
from piezo_models.linear.dynamics import CreepDynamics

PERIOD_S, DELAY = 1e-3, 0.75
FREQUENCY, DAMPING = 2.0 * np.pi * 80.0, 0.02
NOISE_UM = 0.002


def recording(lag_s=1e-9, seed=1):
    """Rings on for a fifth of the period, so that the first periods are unlike the others."""
    stage = IndependentStage(lag_s, ((FREQUENCY, DAMPING, 1.0),), delay_s=DELAY * PERIOD_S,
                             gains_um_per_v=(0.1,), half_widths_v=(0.0,))
    return stage.record(square_wave_v(0.5, PERIOD_S, 20, 40.0, 70.0), PERIOD_S, NOISE_UM, seed)


def test_a_delay_is_not_taken_for_a_mode_and_its_deviation_agrees_with_its_verdict():
    estimate = estimate_dynamics(recording(), CreepDynamics())
    assert str(estimate.order) == "1"
    assert estimate.residual_rms < 1.2 * NOISE_UM / np.sqrt(18.0)
    found = estimate.model
    (deviation,) = estimate.standard_deviations["damping_ratios"]
    assert abs(found.damping_ratios[0] - DAMPING) < 4.0 * deviation
    error = estimate.delay.samples - DELAY
    spread = estimate.delay.standard_deviation_s / PERIOD_S
    assert abs(error) < 4.0 * spread < 0.3 * DELAY
    assert estimate.delay.is_significant
    # That there is no lag is told, and how small it is.
    assert found.time_constant_s < 4.0 * estimate.standard_deviations["time_constant_s"]
    assert estimate.standard_deviations["time_constant_s"] < 0.1 * PERIOD_S


@pytest.mark.long
def test_the_deviation_of_a_delay_beside_a_lag_is_that_of_many_draws():
    def fitted(lag, seed):
        record = mean_period(recording(lag * PERIOD_S, seed), CreepDynamics())
        fit = record.fit(ModeOrder(1), np.log([0.3 * PERIOD_S, FREQUENCY, DAMPING]), 0.5)
        return fit.delay, np.sqrt(fit_covariance(fit, record.linear_parameters)[-1, -1])

    for lag in (1e-6, 0.6):
        delays, deviations = np.array([fitted(lag, seed) for seed in range(12)]).T
        scatter = np.sqrt(np.mean((delays - DELAY) ** 2))
        assert 0.4 * scatter < np.median(deviations) < 3.0 * scatter


def test_a_delay_that_is_far_better_has_a_deviation_that_says_so():
    random = np.random.default_rng(1)
    fit, without = (FastFit(ModeOrder(0), np.zeros(1), 0.5, scale * random.normal(size=400),
                            np.empty((400, 2))) for scale in (1.0, 1.5))
    deviation = delay_deviation(fit, without, 1e4)
    assert deviation == pytest.approx(0.5 / np.sqrt(400 * np.log(2.25)), rel=0.2)
    assert delay_deviation(fit, None, 1e4) == 100.0
    assert delay_deviation(fit, without, 1e-6) == pytest.approx(1e-3)
