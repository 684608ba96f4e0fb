# SPDX-License-Identifier: BSD-3-Clause
"""Levenberg-Marquardt minimisation of a function that is bounded by sums of squares."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import lsq_linear

from piezo_common.arrays import FloatArray
from piezo_common.budget import is_time_up
from piezo_common.long_matrix import triangle_of

FIRST_DAMPING, FACTOR, MOST_DAMPING = 1e-3, 10.0, 1e6
"""The first step is undamped. A step without gain is retried with the first damping, then with a
damping that grows by the factor each time. A step with gain reduces the damping by the factor."""


class Objective(Protocol):
    """A function to minimise within bounds."""

    low: FloatArray
    high: FloatArray
    """Bounds of the unknowns, (n,)."""
    longest: FloatArray
    """Largest change of each unknown in one step, (n,)."""

    def value(self, vector: FloatArray) -> float:
        """Return the value of the function."""

    def linearised(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return residuals (m,) and their derivatives (m, n).

        Half of the sum of their squares has the gradient of the function at this point, and a step
        that reduces it by some amount reduces the function by at least that amount.
        """


@dataclass(frozen=True, eq=False)
class Descent:
    """Result of a minimisation."""

    vector: FloatArray

    value: float
    """Value of the function at `vector`."""
    gain: float
    """Gain of the last step, or the predicted gain of the next step if that is not worthwhile."""
    has_converged: bool
    """True if no step is predicted to be worthwhile."""


def descend(objective: Objective, vector: FloatArray, steps: int, worthwhile: float) -> Descent:
    """Take steps until the predicted gain is too small, the steps are used up, or time is up.

    The initial unknowns, (n,), are within the bounds. `worthwhile` is the smallest predicted gain
    for which a step is taken.
    """
    value, gain, damping = objective.value(vector), np.inf, 0.0
    for _ in range(steps):
        if is_time_up():
            break
        residual, jacobian = objective.linearised(vector)
        if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
            return Descent(vector, value, 0.0, True)
        triangle = triangle_of(np.column_stack([jacobian, residual]))
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
            # The derivatives do not match the function, as at a kink.
            return Descent(vector, value, 0.0, True)
        vector, gain, value = tried, value - now, now
        damping = damping / FACTOR if damping > FIRST_DAMPING else 0.0
    return Descent(vector, value, gain, gain < worthwhile)


def _step(objective: Objective, vector: FloatArray, triangle: FloatArray,
          damping: float) -> tuple[FloatArray, float]:
    """Return the best step of the linearised residuals within the bounds, and its predicted gain.

    The triangle of the QR factors of the derivatives and residuals replaces these, which are as
    long as the recordings.
    """
    columns, target = triangle[:, :-1], triangle[:, -1]
    # Marquardt's scaling: each unknown is damped in proportion to its effect.
    damped = np.sqrt(damping) * np.diag(np.linalg.norm(columns, axis=0))
    low = np.maximum(objective.low - vector, -objective.longest)
    high = np.minimum(objective.high - vector, objective.longest)
    within = np.maximum(high, low + np.finfo(float).eps)
    step = lsq_linear(np.vstack([columns, damped]),
                      -np.concatenate([target, np.zeros(vector.size)]),
                      bounds=(low, within), method="bvls").x
    residual = target + columns @ step
    return step, 0.5 * float(target @ target - residual @ residual)
