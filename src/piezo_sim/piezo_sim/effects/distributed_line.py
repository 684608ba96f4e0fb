# SPDX-License-Identifier: BSD-3-Clause
"""Resistance and capacitance along a stack of piezo layers, as a line open at its end.

The mean voltage of all layers follows that at the entrance by tanh(q) / q with q = sqrt(s R C), a
lag of half order at high frequencies. Its partial fractions are

    sum over k of w_k / (1 + s / p_k),   p_k = ((k + 1/2) pi)^2 / (R C),   w_k = 2 / (p_k R C),

whose weights add up to one.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import Surroundings, parameter, require

# Parts with more than this many decays per sample have no state from one sample to the next.
_FASTEST = 36.0


@njit(cache=True)
def _charge(samples: FloatArray, levels_v: FloatArray, weights: FloatArray, decays: FloatArray,
            mean_decays: FloatArray, instant: float) -> None:
    for n in range(samples.size):
        entrance_v = samples[n]
        mean_v = instant * entrance_v
        for k in range(levels_v.size):
            missing_v = levels_v[k] - entrance_v
            mean_v += weights[k] * (entrance_v + mean_decays[k] * missing_v)
            levels_v[k] = entrance_v + decays[k] * missing_v
        samples[n] = mean_v


@dataclass(frozen=True)
class DistributedLine:
    """Line with its total resistance and capacitance."""

    name: ClassVar[str] = "distributed_line"

    resistance_ohm: float = parameter("ohm")
    capacitance_f: float = parameter("F")

    def __post_init__(self) -> None:
        require(self.resistance_ohm > 0.0, self, "resistance_ohm must be positive.")
        require(self.capacitance_f > 0.0, self, "capacitance_f must be positive.")

    def start(self, surroundings: Surroundings) -> "LineRunner":
        """Start with a charge that `rest` sets."""
        return LineRunner(self, surroundings.sample_period_s)


class LineRunner:
    """Line with the levels of its partial fractions as state."""

    def __init__(self, effect: DistributedLine, sample_period_s: float) -> None:
        charging_s = effect.resistance_ohm * effect.capacitance_f
        count = math.ceil(math.sqrt(_FASTEST * charging_s / sample_period_s) / math.pi + 0.5)
        products = ((np.arange(count, dtype=np.float64) + 0.5) * math.pi) ** 2
        exponents = products * (sample_period_s / charging_s)
        weights = 2.0 / products
        self._levels_v = np.zeros(count)
        self._decays = np.exp(-exponents)
        self._mean_decays = -np.expm1(-exponents) / exponents
        self._weights = weights
        self._instant = 1.0 - float(weights.sum())

    def rest(self, level: float) -> float:
        """Settle at the voltage `level`."""
        self._levels_v[:] = level
        return level

    def apply(self, samples: FloatArray) -> None:
        """Replace the voltage at the entrance by the mean over layers and sample."""
        _charge(
            samples, self._levels_v, self._weights, self._decays, self._mean_decays, self._instant
        )
