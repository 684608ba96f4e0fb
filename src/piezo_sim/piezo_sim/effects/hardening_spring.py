# SPDX-License-Identifier: BSD-3-Clause
"""A guide whose resistance increases: a cubic restoring force against the free stroke."""

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.pointwise import PointwiseRunner


@njit(cache=True)
def _balance(samples: FloatArray, relaxed_um: float, length_um: float) -> None:
    # The only real root of a cubic without a square term, in hyperbolic form.
    for n in range(samples.size):
        free = (samples[n] - relaxed_um) / length_um
        root = 2.0 / math.sqrt(3.0) * math.sinh(math.asinh(1.5 * math.sqrt(3.0) * free) / 3.0)
        samples[n] = relaxed_um + length_um * root


@dataclass(frozen=True)
class HardeningSpring(Bounded):
    """Balance e + e^3 / length^2 = f - relaxed of the free stroke f, for x = relaxed + e."""

    name: ClassVar[str] = "hardening_spring"

    relaxed_um: float = parameter("um")
    hardening_length_um: float = parameter("um", POSITIVE)

    def start(self, surroundings: Surroundings) -> PointwiseRunner:
        """Start; there is no state."""
        return PointwiseRunner(_balance, self.relaxed_um, self.hardening_length_um)
