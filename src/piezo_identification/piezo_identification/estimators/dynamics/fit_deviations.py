# SPDX-License-Identifier: BSD-3-Clause
"""Standard deviations of a fit of fast dynamics, and of its delay in the presence of lags."""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.dynamics.fast_dynamics import (
    lag_difference,
    with_lags_apart,
)
from piezo_identification.estimators.dynamics.fast_record import FastFit
from piezo_identification.estimators.estimate import (
    independent_rows,
    parameter_covariance,
)

FAR_MORE = 2.0
"""Ratio of the residual power without and with a delay that is evidence of a delay."""


def fit_covariance(fit: FastFit, linear_parameters: int) -> FloatArray:
    """Return the covariance of the vector of a fit, and of its delay if that was fitted.

    It is (P, P) or (P + 1, P + 1), of logarithms except for participations of parallel modes and
    the delay. It differs in three ways from that of a linear fit with white residual. Neighbouring
    errors of an incomplete model are correlated, and count less. The response depends on two nearly
    equal lags only by the square of their difference. And a short lag, which cannot be negative,
    differs from a delay only by its square. So many other parameters were fitted linearly.
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
    """Limit the variance of the difference of two lags to what follows from its square.

    If the square of half their difference x has the deviation d, a large x has the deviation
    d / (2 x), and one that may be zero is below (2 d)^(1/2). The covariance is that of the
    Jacobian with the lags apart.
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
    # The mean of both lags is not changed; the difference is scaled.
    scale = np.eye(covariance.shape[0])
    stretch = bounded / np.sqrt(variance) - 1.0
    scale[lags] += 0.5 * stretch * np.array([[1.0, -1.0], [-1.0, 1.0]])
    scaled: FloatArray = scale @ covariance @ scale.T
    return scaled


def _of_positive_lag(covariance: FloatArray, lag: int) -> FloatArray:
    """Limit the variance of a lag to what follows from its square.

    To first order, a lag T acts as a delay T; with a delay, only T^2 / 2 is identifiable. If that
    has the deviation d, a long lag has the deviation d / T, and one that may be zero is below
    (2 d)^(1/2). The variances of all correlated parameters are reduced as if the lag had been
    measured.
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

    If the fit without the delay, of the same order, is far worse, there must be a delay, whatever
    else the model lacks. The deviation is then at most the delay over the square root of twice the
    gain in log-likelihood.
    """
    deviation = float(np.sqrt(variance))
    if without is None or without.cost <= FAR_MORE * fit.cost:
        return deviation
    rows = independent_rows(fit.residual)
    return min(deviation, abs(fit.delay) / float(np.sqrt(rows * np.log(without.cost / fit.cost))))
