# SPDX-License-Identifier: BSD-3-Clause
"""Backlash between the drive and the driven part, with a gradual onset of contact.

The driven part trails the drive by e. A drive that reverses first closes half the gap freely, until
e = 0. From there contact increases by de/dx = 1 - (e / gap)^2, so that e = gap tanh(x / gap).
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.state_runner import StateRunner


@njit(cache=True)
def _trail(samples: FloatArray, drive_um: float, trail_um: float,
           gap_um: float) -> tuple[float, float]:
    for n in range(samples.size):
        move_um = samples[n] - drive_um
        drive_um = samples[n]
        if move_um * trail_um < 0.0:
            free_um = math.copysign(min(abs(move_um), abs(trail_um)), move_um)
            trail_um += free_um
            move_um -= free_um
        # tanh(a + b) from tanh(a) and tanh(b): the result does not depend on the number of steps.
        if move_um != 0.0:
            contact = math.tanh(move_um / gap_um)
            engaged = trail_um / gap_um
            trail_um = gap_um * (contact + engaged) / (1.0 + contact * engaged)
        samples[n] = drive_um - trail_um
    return drive_um, trail_um


@dataclass(frozen=True)
class SoftBacklash(Bounded):
    """The driven part trails by at most half the backlash, `half_gap_um`, in either direction."""

    name: ClassVar[str] = "soft_backlash"

    half_gap_um: float = parameter("um", POSITIVE)

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start at a displacement that was reached from far below."""
        gap_um = self.half_gap_um
        return StateRunner(_trail, lambda level: ((level, gap_um), level - gap_um), (gap_um,))
