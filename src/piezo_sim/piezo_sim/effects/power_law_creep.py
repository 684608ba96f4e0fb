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
from piezo_sim.plant.plant_effect import Surroundings, parameter, require

# Relaxations faster than this number over the onset time have weights below exp(-12).
_FASTEST = 12.0


@njit(cache=True)
def _creep(samples: FloatArray, levels: FloatArray, weights: FloatArray,
           shares: FloatArray) -> None:
    for n in range(samples.size):
        level = samples[n]
        output = level
        for k in range(levels.size):
            output += weights[k] * levels[k]
            levels[k] += shares[k] * (level - levels[k])
        samples[n] = output


@dataclass(frozen=True)
class PowerLawCreep:
    """Creep by the power `exponent` of time, from the onset until the memory ends."""

    name: ClassVar[str] = "power_law_creep"

    creep_at_reference: float = parameter("1")
    reference_time_s: float = parameter("s")
    exponent: float = parameter("1")
    onset_time_s: float = parameter("s")
    memory_s: float = parameter("s")

    def __post_init__(self) -> None:
        require(0.0 < self.exponent < 1.0, self, "exponent must be between 0 and 1.")
        require(self.onset_time_s > 0.0, self, "onset_time_s must be positive.")
        require(self.reference_time_s > 0.0, self, "reference_time_s must be positive.")
        require(
            self.memory_s > self.onset_time_s, self, "memory_s must be longer than onset_time_s."
        )

    def start(self, surroundings: Surroundings) -> "CreepRunner":
        """Start with relaxations that `rest` sets."""
        return CreepRunner(self, surroundings.sample_period_s)


class CreepRunner:
    """Creep with the level of each relaxation as its state."""

    def __init__(self, effect: PowerLawCreep, sample_period_s: float) -> None:
        fastest = math.log(_FASTEST)
        slowest = math.log(effect.onset_time_s / effect.memory_s)
        rates = np.exp(np.arange(slowest, fastest + 1.0))
        reference = math.expm1(
            effect.exponent * math.log1p(effect.reference_time_s / effect.onset_time_s)
        )
        scale = effect.creep_at_reference / reference * effect.exponent / gamma(1 - effect.exponent)
        self._weights = scale * np.exp(-rates) * rates**-effect.exponent
        self._shares = -np.expm1(-rates * sample_period_s / effect.onset_time_s)
        self._levels = np.zeros(rates.size)

    def rest(self, level: float) -> float:
        """Settle at the constant input `level`; return the output with all creep."""
        self._levels[:] = level
        return float(level * (1.0 + self._weights.sum()))

    def apply(self, samples: FloatArray) -> None:
        """Add to the inputs their creep at the start of each sample."""
        _creep(samples, self._levels, self._weights, self._shares)
