# SPDX-License-Identifier: BSD-3-Clause
"""An actuator that its own losses warm, and whose gain depends on the temperature.

Hysteresis loses energy with every micrometre travelled, at any speed.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import NOT_NEGATIVE, POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.state_runner import StateRunner


@njit(cache=True)
def _heat(samples: FloatArray, previous_um: float, warm_k: float, heating_k_per_um: float,
          remaining: float, gain_per_k: float) -> tuple[float, float]:
    for n in range(samples.size):
        travel_um = abs(samples[n] - previous_um)
        previous_um = samples[n]
        warm_k = remaining * warm_k + heating_k_per_um * travel_um
        samples[n] = previous_um * (1.0 + gain_per_k * warm_k)
    return previous_um, warm_k


@dataclass(frozen=True)
class SelfHeating(Bounded):
    """Temperature above ambient from travel and cooling, which changes the gain.

    Place it behind the hysteresis.
    """

    name: ClassVar[str] = "self_heating"

    heating_k_per_um: float = parameter("K/um", NOT_NEGATIVE)
    cooling_time_constant_s: float = parameter("s", POSITIVE)
    gain_per_k: float = parameter("1/K")

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start at ambient temperature; travel heats."""
        return StateRunner(_heat, lambda level: ((level, 0.0), level), (
            self.heating_k_per_um,
            math.exp(-surroundings.sample_period_s / self.cooling_time_constant_s),
            self.gain_per_k))
