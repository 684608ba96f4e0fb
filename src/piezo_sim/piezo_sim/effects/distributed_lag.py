# SPDX-License-Identifier: BSD-3-Clause
"""A lag spread over many small ones, like that of a diffusing signal or a filter chain."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit
from scipy.linalg import expm

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter, require
from piezo_sim.plant.state_runner import StateRunner


@njit(cache=True)
def _advance(samples: FloatArray, state: FloatArray, following: FloatArray, previous: float,
             a: FloatArray, held: FloatArray,
             ramp: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    order = state.size
    for n in range(samples.size):
        level = samples[n]
        change = level - previous
        for i in range(order):
            value = held[i] * previous + ramp[i] * change
            for j in range(i + 1):
                value += a[i, j] * state[j]
            following[i] = value
        for i in range(order):
            state[i] = following[i]
        previous = level
        samples[n] = state[order - 1]
    return state, following, previous


@dataclass(frozen=True)
class DistributedLag(Bounded):
    """Equal first-order lags in series, which together delay a slow signal by `lag_s`.

    Between its samples the input is taken as straight, so that holding adds no delay.
    """

    name: ClassVar[str] = "distributed_lag"

    lag_s: float = parameter("s", POSITIVE)
    sections: int = parameter("1")

    def __post_init__(self) -> None:
        super().__post_init__()
        require(1 <= self.sections <= 32, self, "sections must be an integer from 1 to 32.")

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start with the sections at the level that `rest` sets."""
        n = self.sections
        turned = n / self.lag_s * surroundings.sample_period_s
        # Augmented by the input and its slope, both over one sample period.
        augmented = np.zeros((n + 2, n + 2))
        augmented[:n, :n] = turned * (np.eye(n, k=-1) - np.eye(n))
        augmented[0, n] = turned
        augmented[n, n + 1] = 1.0
        exponential = expm(augmented)
        return StateRunner(
            _advance, lambda level: ((np.full(n, level), np.zeros(n), level), level),
            tuple(np.ascontiguousarray(part) for part in (
                exponential[:n, :n], exponential[:n, n], exponential[:n, n + 1])))
