# SPDX-License-Identifier: BSD-3-Clause
"""A lag spread over many small ones, like that of a diffusing signal or a filter chain."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit
from scipy.linalg import expm

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import Surroundings, parameter, require


@njit(cache=True)
def _advance(samples: FloatArray, state: FloatArray, following: FloatArray, previous: float,
             a: FloatArray, held: FloatArray, ramp: FloatArray) -> float:
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
    return previous


@dataclass(frozen=True)
class DistributedLag:
    """Equal first-order lags in series, which together delay a slow signal by `lag_s`.

    Between its samples the input is taken as straight, so that holding adds no delay.
    """

    name: ClassVar[str] = "distributed_lag"

    lag_s: float = parameter("s")
    sections: int = parameter("1")

    def __post_init__(self) -> None:
        require(self.lag_s > 0.0, self, "lag_s must be positive.")
        require(1 <= self.sections <= 32, self, "sections must be an integer from 1 to 32.")

    def start(self, surroundings: Surroundings) -> "DistributedLagRunner":
        """Start with states that `rest` sets."""
        return DistributedLagRunner(self, surroundings.sample_period_s)


class DistributedLagRunner:
    """Distributed lag with the state of each section."""

    def __init__(self, effect: DistributedLag, sample_period_s: float) -> None:
        n = effect.sections
        rate = n / effect.lag_s
        # Augmented by the input and its slope, both over one sample period.
        augmented = np.zeros((n + 2, n + 2))
        augmented[:n, :n] = rate * sample_period_s * (np.eye(n, k=-1) - np.eye(n))
        augmented[0, n] = rate * sample_period_s
        augmented[n, n + 1] = 1.0
        exponential = expm(augmented)
        self._matrices = tuple(
            np.ascontiguousarray(part)
            for part in (exponential[:n, :n], exponential[:n, n], exponential[:n, n + 1])
        )
        self._state = np.zeros(n)
        self._following = np.zeros(n)
        self._previous = 0.0

    def rest(self, level: float) -> float:
        """Settle at the constant input `level`."""
        self._state[:] = level
        self._previous = level
        return level

    def apply(self, samples: FloatArray) -> None:
        """Replace samples by delayed ones."""
        self._previous = _advance(
            samples, self._state, self._following, self._previous, *self._matrices
        )
