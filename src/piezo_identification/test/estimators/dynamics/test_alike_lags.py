# SPDX-License-Identifier: BSD-3-Clause
"""An amplifier and a sensor that lag nearly alike: only the square of their difference is told."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from independent_stage import IndependentStage, square_wave_v

from piezo_identification.estimators.dynamics.fast_dynamics import (
    ModeOrder,
    lag_difference,
    with_lags_apart,
)
from piezo_identification.estimators.dynamics.fast_estimate import mean_period
from piezo_identification.estimators.dynamics.fit_deviations import fit_covariance
from piezo_models.linear.dynamics import CreepDynamics

PERIOD_S, NOISE_UM, LAG_S = 25e-6, 0.009, 1.25e-4
MODE = (3900.0, 0.1)
ORDER = ModeOrder(1, sensor_lags=1)


@pytest.mark.parametrize("ratio", [
    pytest.param(1.0, marks=pytest.mark.long), 1.02, pytest.param(1.5, marks=pytest.mark.long)])
def test_the_deviation_of_lags_is_that_of_many_draws(ratio):
    stage = IndependentStage(ratio * LAG_S, ((*MODE, 1.0),), sensor_lag_s=LAG_S)
    exact = stage.record(square_wave_v(periods=18), PERIOD_S)
    errors = []
    for seed in range(8):
        noise_um = NOISE_UM * np.random.default_rng(seed).normal(size=exact.displacement_um.size)
        record = mean_period(
            replace(exact, displacement_um=exact.displacement_um + noise_um), CreepDynamics())
        fit = record.fit(ORDER, np.log([1.2 * LAG_S, *MODE, 0.9 * LAG_S]), 0.0, 200, False, 1e-12)
        covariance = fit_covariance(fit, record.linear_parameters)
        larger = 0 if lag_difference(fit.vector, ORDER) > 0.0 else -1
        errors.append((fit.vector[larger] - np.log(ratio * LAG_S))
                      / np.sqrt(covariance[larger, larger]))
    assert np.abs(errors).max() < 3.5
    assert np.sqrt(np.mean(np.square(errors))) > 0.2


def test_only_lags_that_are_nearly_equal_are_taken_apart():
    vector = np.log([1e-4, *MODE, 2e-4])
    assert with_lags_apart(vector, ORDER) is vector
    apart = with_lags_apart(np.log([1e-4, *MODE, 1.001e-4]), ORDER)
    assert apart[0] < apart[-1]
    assert apart[0] + apart[-1] == pytest.approx(np.log(1e-4) + np.log(1.001e-4))
