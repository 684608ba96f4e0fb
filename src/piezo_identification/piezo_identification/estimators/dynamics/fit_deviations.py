# SPDX-License-Identifier: BSD-3-Clause
"""Standard deviations of a fit of fast dynamics, and of its delay beside its lags."""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.dynamics.fast_dynamics import (
    lag_difference,
    with_lags_apart,
)
from piezo_identification.estimators.dynamics.fast_record import FastFit
from piezo_identification.estimators.estimate import (
    SIGNIFICANT,
    independent_rows,
    parameter_covariance,
)

FAR_MORE = 2.0
"""Times the power that a fit has to leave without its delay for that to be evidence of it."""


def fit_covariance(fit: FastFit, linear_parameters: int) -> FloatArray:
    """Covariance of the vector of a fit, and of its delay where that was fitted.

    Three things part it from that of a linear fit with white residual. What a form cannot explain
    is no white noise: neighbours are alike, and count less. Two lags that are nearly equal differ
    by the square of their difference only. And a lag cannot be negative: a short one differs from a
    delay by its square only.

    Parameters
    ----------
    linear_parameters : int
        That were fitted beside.

    Returns
    -------
    ndarray, shape (P, P) or (P + 1, P + 1)
        Of logarithms, but for the parts of modes beside others and the delay.
    """
    covariance = parameter_covariance(
        fit.jacobian, fit.residual, fit.jacobian.shape[1] + linear_parameters)
    covariance *= fit.residual.size / independent_rows(fit.residual)
    if fit.order.sensor_lags:
        covariance = _of_alike_lags(covariance, fit)
    last = fit.order.positive
    for lag in [0, *range(last - fit.order.sensor_lags, last)]:
        covariance = _of_positive_lag(covariance, lag)
    return covariance


def _of_alike_lags(covariance: FloatArray, fit: FastFit) -> FloatArray:
    """Bound the variance of the difference of two lags by what its square lets it be.

    If the square of half their difference x has the deviation d, a large x has the deviation
    d / (2 x), and one that may be none is below (2 d)^(1/2).

    Parameters
    ----------
    covariance : ndarray, shape (P, P)
        Of the Jacobian where the lags are apart.
    fit : FastFit
        With a sensor's lag.
    """
    one, other = 0, fit.order.positive - 1
    half = abs(lag_difference(fit.vector, fit.order))
    taken_at = abs(lag_difference(with_lags_apart(fit.vector, fit.order), fit.order))
    lags = np.ix_([one, other], [one, other])
    sides = np.array([0.5, -0.5])
    variance = sides @ covariance[lags] @ sides
    if not np.isfinite(variance) or variance <= 0.0:
        return covariance
    of_square = 2.0 * taken_at * np.sqrt(variance)
    largest = np.sqrt(2.0 * of_square)
    bounded = of_square / (2.0 * half) if 2.0 * half * largest > of_square else largest
    # The mean of both lags stays as it is, the difference is scaled.
    scale = np.eye(covariance.shape[0])
    stretch = bounded / np.sqrt(variance) - 1.0
    scale[lags] += 0.5 * stretch * np.array([[1.0, -1.0], [-1.0, 1.0]])
    scaled: FloatArray = scale @ covariance @ scale.T
    return scaled


def _of_positive_lag(covariance: FloatArray, lag: int) -> FloatArray:
    """Bound the variance of a lag by what its square lets it be.

    A lag T acts as a delay T in first order; only T^2 / 2 is identifiable beside a delay. If that
    has the deviation d, a long lag has the deviation d / T, and one that may be none is below
    (2 d)^(1/2). What the variance loses is taken from all that trade with the lag, as if it had
    been measured.

    Parameters
    ----------
    covariance : ndarray, shape (P, P)
    lag : int
        Place of its logarithm.
    """
    variance = covariance[lag, lag]
    # In the logarithm: d / T^2 against (2 d)^(1/2) / T.
    if not np.isfinite(variance) or variance <= 4.0:
        return covariance
    kept = 2.0 / np.sqrt(variance)
    trade = covariance[:, lag] / np.sqrt(variance)
    trade[~np.isfinite(trade)] = 0.0
    bounded: FloatArray = covariance - (1.0 - kept) * np.outer(trade, trade)
    return bounded


def delay_deviation(fit: FastFit, without: FastFit | None, variance: float) -> float:
    """Return the standard deviation of a delay, in sample periods.

    Where the fit without the delay leaves far more, there is a delay whatever else the form lacks:
    the deviation is then no larger than the delay over the root of twice the gain in logarithmic
    likelihood.

    Parameters
    ----------
    without : FastFit or None
        The same order, fitted with no delay; None where that was not asked.
    variance : float
        Of the delay, from the covariance.
    """
    deviation = float(np.sqrt(variance))
    if without is None or without.cost <= FAR_MORE * fit.cost:
        return deviation
    rows = independent_rows(fit.residual)
    return min(deviation, abs(fit.delay) / float(np.sqrt(rows * np.log(without.cost / fit.cost))))


def is_significant(fit: FastFit, variance: float) -> bool:
    """Whether the covariance alone shows that there is a delay."""
    return bool(abs(fit.delay) > SIGNIFICANT * np.sqrt(variance))
