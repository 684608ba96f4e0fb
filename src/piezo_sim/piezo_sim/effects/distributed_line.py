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
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.state_runner import StateRunner

# Parts with more than this many decays per sample have no state from one sample to the next.
_FASTEST = 36.0


@njit(cache=True)
def _charge(samples: FloatArray, levels_v: FloatArray, weights: FloatArray, decays: FloatArray,
            mean_decays: FloatArray, instant: float) -> tuple[FloatArray]:
    for n in range(samples.size):
        entrance_v = samples[n]
        mean_v = instant * entrance_v
        for k in range(levels_v.size):
            missing_v = levels_v[k] - entrance_v
            mean_v += weights[k] * (entrance_v + mean_decays[k] * missing_v)
            levels_v[k] = entrance_v + decays[k] * missing_v
        samples[n] = mean_v
    return (levels_v,)


@dataclass(frozen=True)
class DistributedLine(Bounded):
    """Line with its total resistance and capacitance."""

    name: ClassVar[str] = "distributed_line"

    resistance_ohm: float = parameter("ohm", POSITIVE)
    capacitance_f: float = parameter("F", POSITIVE)

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start with the levels of the partial fractions that `rest` sets."""
        charging_s = self.resistance_ohm * self.capacitance_f
        period_s = surroundings.sample_period_s
        count = math.ceil(math.sqrt(_FASTEST * charging_s / period_s) / math.pi + 0.5)
        products = ((np.arange(count, dtype=np.float64) + 0.5) * math.pi) ** 2
        exponents = products * (period_s / charging_s)
        weights = 2.0 / products
        return StateRunner(_charge, lambda level: ((np.full(count, level),), level), (
            weights, np.exp(-exponents), -np.expm1(-exponents) / exponents,
            1.0 - float(weights.sum())))
