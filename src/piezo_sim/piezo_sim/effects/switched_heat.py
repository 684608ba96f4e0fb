# SPDX-License-Identifier: BSD-3-Clause
"""Thermal expansion by a heat source that is switched on at a given time."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import NOT_NEGATIVE, POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.state_runner import StateRunner


def _heat(samples: FloatArray, sample: int, expansion_um: float, rate: float) -> tuple[int]:
    end = sample + samples.size
    if end > 0:
        samples -= expansion_um * np.expm1(-rate * np.maximum(np.arange(sample, end), 0))
    return (end,)


@dataclass(frozen=True)
class SwitchedHeat(Bounded):
    """A displacement e (1 - exp(-(t - t0) / tau)) from t0 on."""

    name: ClassVar[str] = "switched_heat"

    expansion_um: float = parameter("um")
    time_constant_s: float = parameter("s", POSITIVE)
    begin_s: float = parameter("s", NOT_NEGATIVE)

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start the clock, with the source off."""
        period_s = surroundings.sample_period_s
        return StateRunner(
            _heat, lambda level: ((-round(self.begin_s / period_s),), level),
            (self.expansion_um, period_s / self.time_constant_s))
