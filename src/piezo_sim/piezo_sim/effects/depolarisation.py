# SPDX-License-Identifier: BSD-3-Clause
"""A ceramic that loses polarisation, and therefore gain, with the travelled distance."""

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter, require
from piezo_sim.plant.state_runner import StateRunner


@njit(cache=True)
def _age(samples: FloatArray, previous_um: float, travelled_um: float, lost_gain: float,
         travel_um: float) -> tuple[float, float]:
    for n in range(samples.size):
        travelled_um += abs(samples[n] - previous_um)
        previous_um = samples[n]
        samples[n] = previous_um * (1.0 + lost_gain * math.expm1(-travelled_um / travel_um))
    return previous_um, travelled_um


@dataclass(frozen=True)
class Depolarisation(Bounded):
    """The gain falls by `lost_gain` in the end, by 63 % of that after the distance `travel_um`.

    Place it behind the hysteresis.
    """

    name: ClassVar[str] = "depolarisation"

    lost_gain: float = parameter("1")
    travel_um: float = parameter("um", POSITIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.lost_gain < 1.0, self, "lost_gain must be below 1.")

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start with a fresh ceramic; `rest` starts the count of the distance."""
        return StateRunner(_age, lambda level: ((level, 0.0), level),
                           (self.lost_gain, self.travel_um))
