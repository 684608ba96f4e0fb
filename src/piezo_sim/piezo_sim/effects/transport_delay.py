# SPDX-License-Identifier: BSD-3-Clause
"""A pure delay that need not be a whole number of samples."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import Surroundings, parameter, require


@njit(cache=True)
def _delay(samples: FloatArray, history: FloatArray, newest: int, first: int,
           weights: FloatArray) -> int:
    length = history.size
    for n in range(samples.size):
        newest = (newest + 1) % length
        history[newest] = samples[n]
        output = 0.0
        for j in range(weights.size):
            output += weights[j] * history[(newest - first - j) % length]
        samples[n] = output
    return newest


@dataclass(frozen=True)
class TransportDelay:
    """Delay of a smooth signal: cubic interpolation between its samples."""

    name: ClassVar[str] = "transport_delay"

    delay_s: float = parameter("s")

    def __post_init__(self) -> None:
        require(self.delay_s >= 0.0, self, "delay_s must not be negative.")

    def start(self, surroundings: Surroundings) -> "DelayRunner":
        """Start with a history that `rest` fills."""
        return DelayRunner(self.delay_s / surroundings.sample_period_s)


class DelayRunner:
    """Delay with the samples that it has not put out yet."""

    def __init__(self, delay_samples: float) -> None:
        # Four samples around the delayed instant; none of them in the future.
        self._first = max(math.floor(delay_samples) - 1, 0)
        wanted = delay_samples - self._first
        nodes = np.arange(4.0)
        self._weights = np.array(
            [
                np.prod((wanted - np.delete(nodes, j)) / (j - np.delete(nodes, j)))
                for j in range(nodes.size)
            ]
        )
        self._history = np.zeros(self._first + nodes.size)
        self._newest = 0

    def rest(self, level: float) -> float:
        """Fill the history with the constant input `level`."""
        self._history[:] = level
        return level

    def apply(self, samples: FloatArray) -> None:
        """Replace samples by delayed ones."""
        self._newest = _delay(samples, self._history, self._newest, self._first, self._weights)
