# SPDX-License-Identifier: BSD-3-Clause
"""Curvature of a displacement transducer (LVDT): the sensitivity falls towards both ends."""

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.pointwise import PointwiseRunner


@njit(cache=True)
def _bend(samples: FloatArray, centre_um: float, reach_um: float) -> None:
    for n in range(samples.size):
        samples[n] = centre_um + reach_um * math.atan((samples[n] - centre_um) / reach_um)


@dataclass(frozen=True)
class TransducerCurve(Bounded):
    """Reading centre + reach arctan((x - centre) / reach): exact at the centre, flat far off."""

    name: ClassVar[str] = "transducer_curve"

    centre_um: float = parameter("um")
    reach_um: float = parameter("um", POSITIVE)

    def start(self, surroundings: Surroundings) -> PointwiseRunner:
        """Start; there is no state."""
        return PointwiseRunner(_bend, self.centre_um, self.reach_um)
