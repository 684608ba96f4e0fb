# SPDX-License-Identifier: BSD-3-Clause
"""Creep with the logarithm of time, as in piezo-ceramics.

After a unit step the output is 1 + gain ln(1 + t / onset). By Frullani's integral

    ln(1 + t / onset) = int exp(-onset exp(s)) (1 - exp(-t exp(s))) ds  over all s,

this is a sum of relaxations whose rates exp(s) are evenly spaced in s. The trapezoidal rule with
unit spacing is exact to 1e-4, because the integrand is analytic and vanishes at both ends.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_sim.plant.linear_effects import StateSpace
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, parameter, require

# Relaxations faster than this number over the onset time have weights below exp(-12).
_FASTEST = 12.0


@dataclass(frozen=True)
class LogarithmicCreep(Bounded):
    """Creep of `gain_per_efold` for each e-fold of time, from the onset until the memory ends."""

    name: ClassVar[str] = "logarithmic_creep"

    gain_per_efold: float = parameter("1")
    onset_time_s: float = parameter("s", POSITIVE)
    memory_s: float = parameter("s")

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            self.memory_s > self.onset_time_s, self, "memory_s must be longer than onset_time_s."
        )

    def state_space(self) -> StateSpace:
        """Return a system with one state for each relaxation."""
        slowest = -math.log(self.memory_s)
        fastest = math.log(_FASTEST / self.onset_time_s)
        rates = np.exp(np.arange(slowest, fastest + 1.0))
        weights = self.gain_per_efold * np.exp(-self.onset_time_s * rates)
        return StateSpace(np.diag(-rates), rates, weights, 1.0)
