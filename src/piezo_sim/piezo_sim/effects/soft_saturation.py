# SPDX-License-Identifier: BSD-3-Clause
"""An amplifier whose output saturates gradually at its supply voltages."""

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter, require
from piezo_sim.plant.pointwise import PointwiseRunner


@njit(cache=True)
def _saturate(samples: FloatArray, low_v: float, high_v: float, knee_v: float) -> None:
    for n in range(samples.size):
        voltage = samples[n]
        above = (voltage - high_v) / knee_v
        below = (low_v - voltage) / knee_v
        # ln(1 + exp(x)) without overflow
        excess = max(above, 0.0) + math.log1p(math.exp(-abs(above)))
        deficit = max(below, 0.0) + math.log1p(math.exp(-abs(below)))
        samples[n] = voltage - knee_v * (excess - deficit)


@dataclass(frozen=True)
class SoftSaturation(Bounded):
    """Identity between the limits, a smooth knee at each."""

    name: ClassVar[str] = "soft_saturation"

    low_v: float = parameter("V")
    high_v: float = parameter("V")
    knee_v: float = parameter("V", POSITIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.low_v < self.high_v, self, "low_v must be below high_v.")

    def start(self, surroundings: Surroundings) -> PointwiseRunner:
        """Start; there is no state."""
        return PointwiseRunner(_saturate, self.low_v, self.high_v, self.knee_v)
