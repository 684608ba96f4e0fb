# SPDX-License-Identifier: BSD-3-Clause
"""Thermal expansion under a varying ambient temperature."""

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import Surroundings, parameter, require
from piezo_sim.plant.random_stream import NormalStream, bits_for


@njit(cache=True)
def _drift(samples: FloatArray, normals: FloatArray, ambient_k: float, stage_k: float,
           expansion_um_per_k: float, walk_k: float, share: float) -> tuple[float, float]:
    for n in range(samples.size):
        samples[n] += expansion_um_per_k * stage_k
        stage_k += share * (ambient_k - stage_k)
        ambient_k += walk_k * normals[n]
    return ambient_k, stage_k


@dataclass(frozen=True)
class ThermalDrift:
    """A thermal mass driven by a random walk of the ambient temperature.

    Temperatures are relative to that of the stage at the first sample.
    """

    name: ClassVar[str] = "thermal_drift"

    expansion_um_per_k: float = parameter("um/K")
    ambient_start_k: float = parameter("K")
    ambient_walk_k_per_sqrt_s: float = parameter("K/s^0.5")
    time_constant_s: float = parameter("s")

    def __post_init__(self) -> None:
        require(
            self.ambient_walk_k_per_sqrt_s >= 0.0,
            self,
            "ambient_walk_k_per_sqrt_s must not be negative.",
        )
        require(self.time_constant_s > 0.0, self, "time_constant_s must be positive.")

    def start(self, surroundings: Surroundings) -> "DriftRunner":
        """Start the walk from the seed."""
        return DriftRunner(self, surroundings)


class DriftRunner:
    """Thermal drift with its temperatures as state."""

    def __init__(self, effect: ThermalDrift, surroundings: Surroundings) -> None:
        period_s = surroundings.sample_period_s
        self._constants = (
            effect.expansion_um_per_k,
            effect.ambient_walk_k_per_sqrt_s * math.sqrt(period_s),
            -math.expm1(-period_s / effect.time_constant_s),
        )
        self._normals = NormalStream(bits_for(effect.name, surroundings.seed))
        self._temperatures_k = (effect.ambient_start_k, 0.0)

    def rest(self, level: float) -> float:
        """Return the level unchanged, as the temperature does not depend on displacement."""
        return level

    def apply(self, samples: FloatArray) -> None:
        """Add the expansion to displacements."""
        normals = self._normals.next(samples.size)
        self._temperatures_k = _drift(samples, normals, *self._temperatures_k, *self._constants)
