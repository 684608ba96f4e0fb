# SPDX-License-Identifier: BSD-3-Clause
"""A pure delay that need not be a whole number of samples."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import NOT_NEGATIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.state_runner import StateRunner


@njit(cache=True)
def _delay(samples: FloatArray, history: FloatArray, newest: int, first: int,
           weights: FloatArray) -> tuple[FloatArray, int]:
    length = history.size
    for n in range(samples.size):
        newest = (newest + 1) % length
        history[newest] = samples[n]
        output = 0.0
        for j in range(weights.size):
            output += weights[j] * history[(newest - first - j) % length]
        samples[n] = output
    return history, newest


@dataclass(frozen=True)
class TransportDelay(Bounded):
    """Delay of a smooth signal: cubic interpolation between its samples."""

    name: ClassVar[str] = "transport_delay"

    delay_s: float = parameter("s", NOT_NEGATIVE)

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start with a history of the level that `rest` sets."""
        delay_samples = self.delay_s / surroundings.sample_period_s
        # Four samples around the delayed instant; none of them in the future.
        first = max(math.floor(delay_samples) - 1, 0)
        wanted, nodes = delay_samples - first, np.arange(4.0)
        weights = np.array([
            np.prod((wanted - np.delete(nodes, j)) / (j - np.delete(nodes, j)))
            for j in range(nodes.size)])
        return StateRunner(
            _delay, lambda level: ((np.full(first + nodes.size, level), 0), level),
            (first, weights))
