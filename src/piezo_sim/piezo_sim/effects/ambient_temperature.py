# SPDX-License-Identifier: BSD-3-Clause
"""Thermal expansion under a varying ambient temperature."""

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import NOT_NEGATIVE, POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.random_stream import NormalStream, bits_for
from piezo_sim.plant.state_runner import StateRunner


@njit(cache=True)
def _drift(samples: FloatArray, normals: FloatArray, ambient_k: float, stage_k: float,
           expansion_um_per_k: float, walk_k: float, share: float) -> tuple[float, float]:
    for n in range(samples.size):
        samples[n] += expansion_um_per_k * stage_k
        stage_k += share * (ambient_k - stage_k)
        ambient_k += walk_k * normals[n]
    return ambient_k, stage_k


@dataclass(frozen=True)
class ThermalDrift(Bounded):
    """A thermal mass driven by a random walk of the ambient temperature.

    Temperatures are relative to that of the stage at the first sample.
    """

    name: ClassVar[str] = "thermal_drift"

    expansion_um_per_k: float = parameter("um/K")
    ambient_start_k: float = parameter("K")
    ambient_walk_k_per_sqrt_s: float = parameter("K/s^0.5", NOT_NEGATIVE)
    time_constant_s: float = parameter("s", POSITIVE)

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start the walk from the seed; it does not depend on the displacement."""
        period_s = surroundings.sample_period_s
        return StateRunner(
            _drift, lambda level: ((self.ambient_start_k, 0.0), level),
            (self.expansion_um_per_k, self.ambient_walk_k_per_sqrt_s * math.sqrt(period_s),
             -math.expm1(-period_s / self.time_constant_s)),
            NormalStream(bits_for(self.name, surroundings.seed)))
