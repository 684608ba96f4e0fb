# SPDX-License-Identifier: BSD-3-Clause
"""Minimise the largest of many smooth functions under bounds by sequential linear programming."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from piezo_common.arrays import FloatArray

BOUND_COST = 5.0
"""Cost per unit beyond a bound; above the multipliers of such problems, so the penalty is exact."""

FIRST_STEP, LARGEST_STEP, LEAST_STEP = 0.1, 0.5, 1e-4
LEAST_GAIN = 1e-4

FIRST_USED = 0.5
"""Distance from the largest value beyond which a function is at first omitted from the program."""

EXCEEDED = 1e-6


@dataclass(frozen=True)
class Linearised:
    """Functions and their derivatives at a vector of parameters."""

    values: FloatArray
    slopes: FloatArray
    """Functions of which the largest is to be minimised, (m,)."""
    bounds: FloatArray
    bound_slopes: FloatArray
    """Functions that may not exceed 0, (k,)."""
    allowed: bool
    """Whether the parameters are admissible at all."""

    @property
    def cost(self) -> float:
        """Return the largest value, plus the penalty for the exceeded bounds."""
        return float(self.values.max() + BOUND_COST * max(0.0, self.bounds.max()))


def lower_largest(linearise: Callable[[FloatArray], Linearised], numbers: FloatArray,
                  low: FloatArray, high: FloatArray, steps: int) -> tuple[FloatArray, Linearised]:
    """Lower the largest value step by step from admissible parameters, (n,), within bounds, (n,).

    Each step is the solution of a linear program within a box, whose size depends on how well the
    linear functions predicted the last step (a trust region).
    """
    numbers = np.clip(numbers, low, high)
    there, size = linearise(numbers), FIRST_STEP
    for _ in range(steps):
        step, foreseen = _step(there, np.maximum(low - numbers, -size),
                               np.minimum(high - numbers, size))
        if not there.cost - foreseen > LEAST_GAIN:
            break
        found = linearise(numbers + step)
        agreement = (there.cost - found.cost) / (there.cost - foreseen)
        if not found.allowed or not agreement > 0.0:
            size /= 2.5
            if size < LEAST_STEP:
                break
            continue
        numbers, there = numbers + step, found
        if agreement > 0.6:
            size = min(1.8 * size, LARGEST_STEP)
        elif agreement < 0.2:
            size /= 2.0
    return numbers, there


def _step(there: Linearised, low: FloatArray, high: FloatArray) -> tuple[FloatArray, float]:
    """Return the best step within a box, and the predicted cost after it.

    Few of the functions matter for a step, so the program begins with the largest ones, and adds
    those that its solution exceeds until there are none.
    """
    count = len(there.values)
    slopes = np.vstack([there.slopes, there.bound_slopes])
    limits = np.r_[there.values, there.bounds]
    # Columns in addition to the step: the largest value, and the excess over the bounds.
    columns = np.zeros((len(limits), 2))
    columns[:count, 0] = columns[count:, 1] = -1.0
    used = np.r_[there.values > there.values.max() - FIRST_USED, np.ones(len(there.bounds), bool)]
    while True:
        found = linprog(
            np.r_[np.zeros(low.size), 1.0, BOUND_COST],
            A_ub=np.column_stack([slopes, columns])[used], b_ub=-limits[used],
            bounds=[*zip(low, high, strict=True), (None, None), (0.0, None)], method="highs")
        if found.x is None:
            return np.zeros(low.size), there.cost
        exceeded = limits + slopes @ found.x[:-2] + columns @ found.x[-2:] > EXCEEDED
        if not (exceeded & ~used).any():
            return found.x[:-2], float(found.fun)
        used |= exceeded
