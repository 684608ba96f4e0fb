# SPDX-License-Identifier: BSD-3-Clause
"""Levenberg-Marquardt steps towards the least of a function that is bounded by sums of squares."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import lsq_linear

from piezo_common.arrays import FloatArray
from piezo_common.budget import is_time_up

FIRST_DAMPING, FACTOR, MOST_DAMPING = 1e-3, 10.0, 1e6
"""The first step is not damped; where one does not gain, it is damped so much, then by a factor
more. A step that gains lets the next be damped by the same factor less."""


class Objective(Protocol):
    """A function to be made least, within bounds.

    Attributes
    ----------
    low, high : (n,) array
        Bounds of the unknowns.
    longest : (n,) array
        By how much one step may change each.
    """

    low: FloatArray
    high: FloatArray
    longest: FloatArray

    def value(self, vector: FloatArray) -> float:
        """Return the function."""

    def linearised(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return residuals (m,) and their derivatives (m, n).

        Half of the sum of their squares has the gradient of the function there, and where a step
        makes it less by some amount, it makes the function less by that at least.
        """


@dataclass(frozen=True, eq=False)
class Descent:
    """Where some steps have led.

    Attributes
    ----------
    vector : (n,) array
    value : float
        Of the function.
    gain : float
        Of the last step, or what the next one promises where it is less than was asked for.
    has_converged : bool
        No step promises as much as was asked for.
    """

    vector: FloatArray
    value: float
    gain: float
    has_converged: bool


def descend(objective: Objective, vector: FloatArray, steps: int, worthwhile: float) -> Descent:
    """Take steps until one promises too little, there are enough, or the time is up.

    Parameters
    ----------
    vector : (n,) array
        To begin from; within the bounds.
    worthwhile : float
        What a step has to promise.
    """
    value, gain, damping = objective.value(vector), np.inf, 0.0
    for _ in range(steps):
        if is_time_up():
            break
        residual, jacobian = objective.linearised(vector)
        if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
            return Descent(vector, value, 0.0, True)
        triangle = np.asarray(np.linalg.qr(np.column_stack([jacobian, residual]), mode="r"))
        step, promise = _step(objective, vector, triangle, damping=0.0)
        if promise < worthwhile:
            return Descent(vector, value, promise, True)
        while True:
            if damping:
                step, promise = _step(objective, vector, triangle, damping)
            tried = np.clip(vector + step, objective.low, objective.high)
            now = objective.value(tried)
            if now < value or damping > MOST_DAMPING:
                break
            damping = max(FACTOR * damping, FIRST_DAMPING)
        if not now < value:
            # The derivatives are not those of the function, as at a kink of it.
            return Descent(vector, value, 0.0, True)
        vector, gain, value = tried, value - now, now
        damping = damping / FACTOR if damping > FIRST_DAMPING else 0.0
    return Descent(vector, value, gain, gain < worthwhile)


def _step(objective: Objective, vector: FloatArray, triangle: FloatArray,
          damping: float) -> tuple[FloatArray, float]:
    """Return the best step of the linearised residuals within the bounds, and what it promises.

    The residuals and their derivatives are as long as the recordings; the triangle of their QR
    factors tells the same.
    """
    columns, target = triangle[:, :-1], triangle[:, -1]
    # Marquardt's scaling: each unknown is damped by what it changes.
    damped = np.sqrt(damping) * np.diag(np.linalg.norm(columns, axis=0))
    low = np.maximum(objective.low - vector, -objective.longest)
    high = np.minimum(objective.high - vector, objective.longest)
    within = np.maximum(high, low + np.finfo(float).eps)
    step = lsq_linear(np.vstack([columns, damped]),
                      -np.concatenate([target, np.zeros(vector.size)]),
                      bounds=(low, within), method="bvls").x
    left = target + columns @ step
    return step, 0.5 * float(target @ target - left @ left)
