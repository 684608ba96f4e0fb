# SPDX-License-Identifier: BSD-3-Clause
"""Thermal expansion by a heat source that is switched on at a given time."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import Surroundings, parameter, require


@dataclass(frozen=True)
class SwitchedHeat:
    """A displacement e (1 - exp(-(t - t0) / tau)) from t0 on."""

    name: ClassVar[str] = "switched_heat"

    expansion_um: float = parameter("um")
    time_constant_s: float = parameter("s")
    begin_s: float = parameter("s")

    def __post_init__(self) -> None:
        require(self.time_constant_s > 0.0, self, "time_constant_s must be positive.")
        require(self.begin_s >= 0.0, self, "begin_s must not be negative.")

    def start(self, surroundings: Surroundings) -> "HeatRunner":
        """Start the clock."""
        return HeatRunner(self, surroundings.sample_period_s)


class HeatRunner:
    """Expansion with its clock as state."""

    def __init__(self, effect: SwitchedHeat, sample_period_s: float) -> None:
        self._expansion_um = effect.expansion_um
        self._rate = sample_period_s / effect.time_constant_s
        self._sample = -round(effect.begin_s / sample_period_s)

    def rest(self, level: float) -> float:
        """Return the level unchanged, as the source is off."""
        return level

    def apply(self, samples: FloatArray) -> None:
        """Add the expansion to displacements."""
        heated = self._sample + np.arange(samples.size)
        self._sample += samples.size
        if self._sample > 0:
            samples -= self._expansion_um * np.expm1(-self._rate * np.maximum(heated, 0))
