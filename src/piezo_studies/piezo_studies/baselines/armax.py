# SPDX-License-Identifier: BSD-3-Clause
"""ARMAX models by the prediction-error method, started by subspace identification."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_identification.estimators.estimate import parameter_covariance


@dataclass(frozen=True)
class Innovations:
    """Discrete system x+ = A x + K e, y = C x + e, without its input."""

    transition: FloatArray
    """Matrix A, (n, n)."""
    innovation_gain: FloatArray
    output_gain: FloatArray
    """Vectors K and C, (n,)."""


def identify_subspace(
    input: FloatArray, output: FloatArray, order: int,
) -> Innovations:
    """Identify a system in innovations form, without initial values or iterations.

    A long autoregression gives the Markov parameters of the predictor. The states are the singular
    vectors of the future output predicted from the past, and two regressions give the matrices
    (Chiuso, "The role of vector autoregressive modeling in predictor-based subspace
    identification", 2007). The signals, (N,), have no offset, and the output responds after one
    sample at the earliest. A record too short for the order, the number of states, raises
    ValueError.
    """
    past = max(40, 4 * order)  # rows of the autoregression
    rows = output.size - past
    if past <= order or rows < 6 * past:
        raise ValueError(
            f"{output.size} samples are too few for a subspace of order {order}: record longer"
        )

    def lags(signal: FloatArray) -> FloatArray:
        # Column j holds the signal j + 1 samples ago.
        return np.lib.stride_tricks.sliding_window_view(signal[:-1], past)[:, ::-1]

    history = np.hstack([lags(output), lags(input)])
    orthogonal, triangle = np.linalg.qr(history)
    target = output[past:]
    markov = np.linalg.lstsq(triangle, orthogonal.T @ target, rcond=1e-12)[0].reshape(2, past)
    # Row i predicts i samples further ahead from the same past.
    future = min(past, max(20, 3 * order))
    predictors = np.zeros((future, 2, past))
    for i in range(future):
        predictors[i, :, : past - i] = markov[:, i:]
    observed = predictors.reshape(future, 2 * past) @ triangle.T
    states = np.linalg.svd(observed, full_matrices=False)[2][:order]
    states = states @ orthogonal.T * np.sqrt(rows)
    output_gain = np.linalg.lstsq(states.T, target, rcond=None)[0]
    innovation = target - output_gain @ states
    present = np.column_stack([states[:, :-1].T, input[past:-1], innovation[:-1]])
    step = np.linalg.lstsq(present, states[:, 1:].T, rcond=None)[0].T
    return Innovations(step[:, :order], step[:, order + 1], output_gain)


MOST_ITERATIONS = 100
MOST_IDLE = 5
"""Consecutive steps with negligible gain after which the search ends."""

LEAST_DAMPING = 1e-18
"""Smallest damping relative to the largest squared singular value. Coefficients of fast samples
differ in the eighth digit, so that more damping would keep them from moving."""


@dataclass(frozen=True)
class Armax:
    """Model A y = B u + C e with polynomials in the shift to earlier samples."""

    autoregressive: FloatArray
    """Polynomial A, beginning with 1, (na + 1,)."""
    input: FloatArray
    """Polynomial B, beginning with 0, (nb + 1,): the output responds after one sample at the
    earliest."""
    noise: FloatArray
    """Polynomial C, beginning with 1, (nc + 1,)."""
    covariance: FloatArray
    """Covariance of the free coefficients, in this order, (na + nb + nc, na + nb + nc)."""
    residual: FloatArray
    """Errors of the one-step prediction, (N,)."""
    parameters: int
    """Number of free parameters of the fit, including those of the unknown past."""

    def response(self, frequency_hz: ArrayLike, sample_period_s: float) -> ComplexArray:
        """Return the complex response B / A at the given frequencies."""
        delay = np.exp(-2j * np.pi * np.asarray(frequency_hz, dtype=float) * sample_period_s)
        return np.polyval(self.input[::-1], delay) / np.polyval(self.autoregressive[::-1], delay)

    def poles(self) -> ComplexArray:
        """Return the discrete poles, shape (na,)."""
        return np.roots(self.autoregressive).astype(complex)


def fit_armax(
    input: FloatArray, output: FloatArray, na: int, nb: int, nc: int,
    drift: FloatArray | None = None,
) -> Armax:
    """Fit an ARMAX model with `na`, `nb` and `nc` coefficients of A, B and C to two signals, (N,).

    It minimises the error of the one-step prediction by Gauss-Newton steps with Levenberg-Marquardt
    damping and the exact Jacobian. White noise on the output makes C equal to A, whose roots are
    near the unit circle for fast sampling. Extended least squares and other starts diverge there; a
    subspace start does not. From it, the model with C = A is fitted first, then C is freed. The
    initial state of the filter is fitted, too. The drift, (N, K), has further regressors of the
    output: constants, as by default, and exponentials in time, whose form a filter does not change.
    A record that is too short raises ValueError.
    """
    orders = (na, nb, nc)
    drift = np.ones((output.size, 1)) if drift is None else drift
    record = _PredictionErrors(input, output, orders, drift)
    parameters = record.start()
    if nc >= na:
        tied = np.eye(parameters.size)
        tied[na + nb : na + nb + na, :na] = np.eye(na)
        free = np.r_[: na + nb, na + nb + nc : parameters.size]
        parameters = _minimise(record, parameters[free], tied[:, free])
    parameters = _minimise(record, parameters, np.eye(parameters.size))
    residual, jacobian = record.errors(parameters)
    a, b, c, _, _ = record.split(parameters)
    free = na + nb + nc
    covariance = parameter_covariance(jacobian, residual)[:free, :free]
    return Armax(a, b, c, covariance, residual, jacobian.shape[1])


def _minimise(record: "_PredictionErrors", reduced: FloatArray,
              expansion: FloatArray) -> FloatArray:
    """Minimize the squared error over `expansion` times a reduced vector; return the parameters."""
    parameters = expansion @ reduced
    residual, jacobian = record.errors(parameters)
    cost, damping, idle = residual @ residual, LEAST_DAMPING, 0
    for _ in range(MOST_ITERATIONS):
        jacobian = jacobian @ expansion
        scale = np.linalg.norm(jacobian, axis=0)
        triangle = np.asarray(
            np.linalg.qr(np.column_stack([jacobian / scale, residual]), mode="r"))
        left, values, right = np.linalg.svd(triangle[:-1, :-1])
        projected = left.T @ triangle[:-1, -1]
        # The optimum would gain less than a thousandth of the gain expected by chance.
        if projected @ projected < 1e-3 * cost / residual.size or idle == MOST_IDLE:
            break
        while damping < 1e6:
            step = right.T @ (values * projected / (values**2 + damping * values[0] ** 2))
            trial = parameters - expansion @ (step / scale)
            if record.invertible(trial):
                trial_residual, trial_jacobian = record.errors(trial)
                trial_cost = trial_residual @ trial_residual
                if trial_cost < cost:
                    break
            damping *= 10.0
        else:
            break
        idle = idle + 1 if (1.0 - trial_cost / cost) * residual.size < 1e-3 else 0
        parameters, residual, jacobian, cost = trial, trial_residual, trial_jacobian, trial_cost
        damping = max(damping / 100.0, LEAST_DAMPING)
    return parameters


class _PredictionErrors:
    """Prediction errors of a record and their derivatives."""

    def __init__(
        self, input: FloatArray, output: FloatArray, orders: tuple[int, int, int],
        drift: FloatArray,
    ) -> None:
        self.input, self.output, self.orders = input, output, orders
        self.drift = np.linalg.qr(drift)[0]
        self.past = max(orders)
        self.impulse = np.zeros(output.size)
        self.impulse[0] = 1.0

    def split(
        self, parameters: FloatArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return A, B, C, the effect of the past on the first samples, and the drift."""
        edges = np.cumsum([*self.orders, self.past])
        a, b, c, past, drift = np.split(parameters, edges)
        return np.append(1.0, a), np.append(0.0, b), np.append(1.0, c), past, drift

    def invertible(self, parameters: FloatArray) -> bool:
        """Return whether C has a stable inverse."""
        roots = np.roots(self.split(parameters)[2])
        return np.abs(roots).max(initial=0.0) < 1.0 - 1e-9

    def errors(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return errors (N,) and Jacobian (N, P), from C e = A y - B u - past - drift."""
        check_cancelled()
        a, b, c, past, drift = self.split(parameters)
        kick = self.drift @ drift
        kick[: past.size] += past
        error = lfilter([1.0], c, lfilter(a, [1.0], self.output)
                        - lfilter(b, [1.0], self.input) - kick)
        filtered = [(lfilter([1.0], c, signal), count, first) for signal, count, first in (
            (self.output, self.orders[0], 1), (-self.input, self.orders[1], 1),
            (-error, self.orders[2], 1), (-self.impulse, past.size, 0))]
        jacobian = np.zeros((error.size, parameters.size))
        column = 0
        for signal, count, first in filtered:
            for lag in range(first, first + count):
                jacobian[lag:, column] = signal[: error.size - lag]
                column += 1
        jacobian[:, column:] = -lfilter([1.0], c, self.drift, axis=0)
        return error, jacobian

    def start(self) -> FloatArray:
        """Return the parameters of the subspace model, with B by regression."""
        na, nb, nc = self.orders
        both = np.column_stack([self.input, self.output])
        both = both - self.drift @ (self.drift.T @ both)
        system = identify_subspace(both[:, 0], both[:, 1], max(na, nc, 1))
        feedback = np.outer(system.innovation_gain, system.output_gain)
        a = np.poly(_inside(np.linalg.eigvals(system.transition).astype(complex), na))
        c = np.poly(_inside(np.linalg.eigvals(system.transition - feedback).astype(complex), nc))
        parameters = np.concatenate([a[1:], np.zeros(nb), c[1:],
                                     np.zeros(self.past + self.drift.shape[1])])
        error, jacobian = self.errors(parameters)
        linear = np.r_[na : na + nb, na + nb + nc : parameters.size]
        parameters[linear] -= np.linalg.lstsq(jacobian[:, linear], error, rcond=1e-12)[0]
        return parameters


def _inside(roots: ComplexArray, count: int) -> ComplexArray:
    """Choose the slowest roots, with those outside the unit circle mirrored into it."""
    magnitude = np.abs(roots)
    roots = np.where(magnitude < 0.9999, roots, 0.9999 * roots / magnitude * np.minimum(
        1.0, 1.0 / magnitude))
    order = np.lexsort((roots.imag, np.round(-np.abs(roots), 12)))
    kept = roots[order][:count]
    # Half of a conjugate pair becomes a real root.
    lonely = [root.imag != 0.0 and not np.isclose(kept, root.conjugate()).any() for root in kept]
    return np.where(lonely, np.abs(kept) * np.sign(kept.real), kept)
