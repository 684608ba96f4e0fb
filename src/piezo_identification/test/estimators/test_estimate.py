# SPDX-License-Identifier: BSD-3-Clause
"""Uncertainties of least squares: against exact numbers, and where a parameter is not told."""

from fractions import Fraction

import numpy as np
import pytest

from piezo_identification.estimators.estimate import (
    Estimate,
    OrderTrial,
    creep_of_partial_fractions,
    order_trial,
    parameter_covariance,
    propagated,
    unidentified_parameters,
)
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics


def exact_inverse(jacobian):
    """Inverse of the normal matrix in rational numbers, which round nothing."""
    columns = [[Fraction(value) for value in column] for column in jacobian.T.tolist()]
    size = len(columns)
    rows = [[sum(a * b for a, b in zip(one, other, strict=True)) for other in columns]
            + [Fraction(int(i == j)) for j in range(size)] for i, one in enumerate(columns)]
    for i in range(size):
        pivot = next(k for k in range(i, size) if rows[k][i])
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in range(size):
            if k != i:
                rows[k] = [a - rows[k][i] * b for a, b in zip(rows[k], rows[i], strict=True)]
    return np.array([[float(value) for value in row[size:]] for row in rows])


@pytest.mark.parametrize("nearness", [1.0, 1e-3, 1e-9])
def test_the_covariance_is_that_of_exact_arithmetic(nearness):
    """The normal matrix of columns that differ by 1e-9 is singular to double precision."""
    random = np.random.default_rng(3)
    base = random.normal(size=(40, 1))
    jacobian = np.hstack([base, base + nearness * random.normal(size=(40, 1)),
                          1e4 * random.normal(size=(40, 1))])
    residual = random.normal(size=40)
    wanted = residual @ residual / 37.0 * exact_inverse(jacobian)
    np.testing.assert_allclose(
        parameter_covariance(jacobian, residual), wanted, rtol=1e-4, atol=1e-9 * wanted.max())


@pytest.mark.parametrize("spoil", [
    lambda jacobian: jacobian.__setitem__((slice(None), 1), 0.0),
    lambda jacobian: jacobian.__setitem__((slice(None), 1), 3.0 * jacobian[:, 2]),
], ids=["no gradient", "same gradient"])
def test_what_the_data_do_not_tell_is_infinite_and_spares_the_rest(spoil):
    random = np.random.default_rng(4)
    jacobian = random.normal(size=(50, 4))
    spoil(jacobian)
    residual = random.normal(size=50)
    covariance = parameter_covariance(jacobian, residual)
    untold = np.isinf(np.diag(covariance))
    assert untold.tolist() == [False, True, bool(jacobian[:, 1].any()), False]
    assert not np.isnan(covariance).any()
    # The others are as if one of those that cannot be told apart were known.
    kept = np.delete(jacobian, 1, axis=1)
    alone = parameter_covariance(kept, residual, 4)
    assert covariance[0, 0] == pytest.approx(alone[0, 0])
    assert covariance[3, 3] == pytest.approx(alone[-1, -1])


def test_what_depends_on_an_unknown_is_unknown():
    covariance = np.diag([1.0, np.inf, 4.0])
    sensitivity = np.array([[1.0, 0.0, 1.0], [0.0, 1e-9, 1.0], [0.0, 0.0, 2.0]])
    result = propagated(sensitivity, covariance)
    assert np.diag(result).tolist() == [5.0, np.inf, 16.0]
    assert not np.isnan(result).any()


def test_creep_with_an_unknown_rate_has_a_model_and_unknown_zeros():
    model, deviations = creep_of_partial_fractions(
        np.array([0.1, 2.0]), np.array([0.05, 0.02]), np.diag([1e-4, np.inf, 1e-6, 1e-6]))
    assert model.poles_rad_per_s == (0.1, 2.0)
    assert deviations["poles_rad_per_s"] == (pytest.approx(1e-2), np.inf)
    assert deviations["zeros_rad_per_s"] == (np.inf, np.inf)


def test_parameters_less_certain_than_large_are_named():
    model = StageModel(
        PreisachModel(-10.0, 10.0, np.zeros((4, 4)), 0.0, np.full(4, 0.5)),
        CreepDynamics((0.1, 1.0), (0.11, 1.1)),
        ElectricVibrationDynamics(0.0, (3000.0,), (0.02,)))
    assert unidentified_parameters(model, {
        "creep": {"poles_rad_per_s": (0.01, np.inf), "zeros_rad_per_s": (0.01, 0.1)},
        "dynamics": {"time_constant_s": 0.0, "mode_frequencies_rad_per_s": (1.0,),
                     "damping_ratios": (0.5,)},
    }) == ["creep poles_rad_per_s 2", "dynamics damping_ratios"]


def test_rounding_is_no_reason_for_a_larger_order(noise):
    """Exact data leave rounding, which a larger order bends to: the smaller one is taken."""
    signal = 10.0 * np.sin(np.arange(800) / 30.0)
    rounding = 1e-10 * noise[:800]
    small = order_trial(2, rounding, 11, signal=signal)
    large = order_trial(3, 0.1 * rounding, 15, signal=signal)
    assert small.information < large.information
    assert order_trial(3, 0.1 * rounding, 15).information < order_trial(2, rounding, 11).information
    # What a converter resolves still counts.
    coarse = 1e-6 * noise[:800]
    assert (order_trial(3, 0.1 * coarse, 15, signal=signal).information
            < order_trial(2, coarse, 11, signal=signal).information)


def test_the_picture_of_the_orders_has_the_trials_of_the_table():
    trials = (OrderTrial(0, 2, 0.4, -700.0), OrderTrial(1, 5, 0.005, -4476.0),
              OrderTrial(2, 8, 0.0049, -4480.0, "two poles are one"))
    figure = Estimate(None, {}, order=1, trials=trials).plot()
    above, below = figure.axes
    assert [line.get_ydata()[0] for line in above.lines] == [3780.0, 4.0, 0.0]
    assert [line.get_ydata()[0] for line in below.lines] == [0.4, 0.005, 0.0049]
    assert [line.get_marker() for line in above.lines] == ["o", "o", "x"]
    assert [line.get_fillstyle() for line in above.lines] == ["none", "full", "none"]
    assert [tick.get_text() for tick in below.get_xticklabels()] == ["0", "1", "2"]
