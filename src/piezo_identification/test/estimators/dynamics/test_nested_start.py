# SPDX-License-Identifier: BSD-3-Clause
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from independent_stage import IndependentStage, square_wave_v

from piezo_identification.estimators.dynamics.fast_dynamics import ModeOrder
from piezo_identification.estimators.dynamics.fast_record import FastFit
from piezo_identification.estimators.dynamics.nested_start import nested_start
from piezo_identification.estimators.dynamics.square_wave import mean_period
from piezo_models.linear.dynamics import CreepDynamics

PERIOD_S = 25e-6
SMALL = ModeOrder(2)


@pytest.fixture(scope="module")
def record():
    stage = IndependentStage(4.9e-4, ((2846.0, 0.3, 0.7), (4909.0, 0.082, 0.3)))
    return mean_period(
        stage.record(square_wave_v(periods=30), PERIOD_S, 0.009, 1), CreepDynamics())


@pytest.fixture(scope="module")
def small(record):
    return record.fit(SMALL, np.log([4.9e-4, 2846.0, 4909.0, 0.3, 0.082]), 0.0)


def embedded(record, smaller, order):
    """A fit of the larger order that goes no step from where it begins."""
    vector, delay = nested_start(smaller, order, PERIOD_S)
    residual, jacobian = record.errors(order, np.append(vector, delay))
    return FastFit(order, vector, delay, residual, jacobian)


@pytest.mark.parametrize("orders", [
    [ModeOrder(8)], [ModeOrder(3), ModeOrder(5), ModeOrder(8)], [ModeOrder(6, 4)],
    [ModeOrder(2, 0, 4)], [ModeOrder(4, 1, 2, 1)]], ids=str)
def test_a_larger_order_begins_with_what_the_smaller_one_leaves(record, small, orders):
    fit = small
    for order in orders:
        fit = embedded(record, fit, order)
    # Modes that are at rest within a sample period, and lags of a hundredth of it, count little.
    assert np.linalg.norm(fit.residual - small.residual) < 0.1 * np.linalg.norm(
        record.measured_um - record.measured_um.mean())
    refitted = record.fit(fit.order, fit.vector, fit.delay)
    assert refitted.cost < 1.001 * small.cost


def test_modes_that_add_nothing_stay_apart(record, small):
    order = ModeOrder(8)
    vector, delay = nested_start(small, order, PERIOD_S)
    fit = record.fit(order, vector + np.r_[np.zeros(3), np.full(6, 9.0), np.zeros(8)], delay)
    frequencies = np.sort(fit.vector[3:9])
    assert np.diff(frequencies).min() > 1e-3
