# SPDX-License-Identifier: BSD-3-Clause
"""Creep by a power of time, the step response of a fractional-order element.

After a unit step the output is 1 + g ((1 + t / t0)^a - 1) / ((1 + t1 / t0)^a - 1): the creep is g
at the reference time t1 and grows by the factor 10^a from each decade to the next. By

    (1 + x)^a - 1 = a / Gamma(1 - a) int exp(-m) (1 - exp(-x m)) m^(-1-a) dm  over m > 0

it is a continuum of relaxations. The trapezoidal rule in ln m, with unit spacing, is exact to 1e-4,
because the integrand is analytic and vanishes at both ends.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit
from scipy.special import gamma

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter, require
from piezo_sim.plant.state_runner import StateRunner

# Relaxations faster than this number over the onset time have weights below exp(-12).
_FASTEST = 12.0


@njit(cache=True)
def _creep(samples: FloatArray, levels: FloatArray, weights: FloatArray,
           shares: FloatArray) -> tuple[FloatArray]:
    for n in range(samples.size):
        level = samples[n]
        output = level
        for k in range(levels.size):
            output += weights[k] * levels[k]
            levels[k] += shares[k] * (level - levels[k])
        samples[n] = output
    return (levels,)


@dataclass(frozen=True)
class PowerLawCreep(Bounded):
    """Creep by the power `exponent` of time, from the onset until the memory ends."""

    name: ClassVar[str] = "power_law_creep"

    creep_at_reference: float = parameter("1")
    reference_time_s: float = parameter("s", POSITIVE)
    exponent: float = parameter("1")
    onset_time_s: float = parameter("s", POSITIVE)
    memory_s: float = parameter("s")

    def __post_init__(self) -> None:
        super().__post_init__()
        require(0.0 < self.exponent < 1.0, self, "exponent must be between 0 and 1.")
        require(
            self.memory_s > self.onset_time_s, self, "memory_s must be longer than onset_time_s."
        )

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start with the relaxations that `rest` sets, all of them over."""
        fastest = math.log(_FASTEST)
        slowest = math.log(self.onset_time_s / self.memory_s)
        rates = np.exp(np.arange(slowest, fastest + 1.0))
        reference = math.expm1(
            self.exponent * math.log1p(self.reference_time_s / self.onset_time_s))
        scale = self.creep_at_reference / reference * self.exponent / gamma(1 - self.exponent)
        weights = scale * np.exp(-rates) * rates**-self.exponent
        shares = -np.expm1(-rates * surroundings.sample_period_s / self.onset_time_s)
        return StateRunner(_creep, lambda level: (
            (np.full(rates.size, level),), float(level * (1.0 + weights.sum()))),
            (weights, shares))
