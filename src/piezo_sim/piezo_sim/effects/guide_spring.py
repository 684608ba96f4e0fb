# SPDX-License-Identifier: BSD-3-Clause
"""A guide with a hardening spring and its mode: Duffing's equation.

With e = y - relaxed the mode obeys y'' / w^2 + 2 zeta y' / w + e + e^3 / length^2 = u - relaxed.
Without the cubic term it would reach x. The displacement that this term removes, z = x - y, obeys
the linear equation of the mode with the cubic term as its drive, so only that is solved step by
step.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.effects.hardening_spring import HardeningSpring
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.state_runner import Rested, StateRunner

LARGEST_TURN_RAD = 0.05
"""Largest angle in rad by which the mode turns in a step: the midpoint rule then has an error of
1e-4 of the effect of the cube."""


@njit(cache=True)
def _swing(samples: FloatArray, before_um: float, taken_um: float, speed_um: float,
           relaxed_um: float, length_um: float, damping_ratio: float, turn_rad: float,
           steps: int) -> tuple[float, float, float]:
    for n in range(samples.size):
        for step in range(steps):
            free_um = before_um + (step + 0.5) / steps * (samples[n] - before_um)
            taken_um += 0.5 * turn_rad * speed_um
            bent = (free_um - taken_um - relaxed_um) / length_um
            pull_um = length_um * bent * bent * bent - taken_um
            damping = damping_ratio * turn_rad
            speed_um = ((1.0 - damping) * speed_um + turn_rad * pull_um) / (1.0 + damping)
            taken_um += 0.5 * turn_rad * speed_um
        before_um = samples[n]
        samples[n] = before_um - taken_um
    return before_um, taken_um, speed_um


@dataclass(frozen=True)
class GuideSpring(Bounded):
    """The cubic part of the spring of a mode; place it behind the mode, with the same numbers."""

    name: ClassVar[str] = "guide_spring"

    frequency_rad_per_s: float = parameter("rad/s", POSITIVE)
    damping_ratio: float = parameter("1", POSITIVE)
    relaxed_um: float = parameter("um")
    hardening_length_um: float = parameter("um", POSITIVE)

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start in the equilibrium of the cubic spring with the drive.

        The state is the drive, the displacement that the cube removes, and its velocity over the
        frequency.
        """
        turned_rad = self.frequency_rad_per_s * surroundings.sample_period_s
        steps = math.ceil(turned_rad / LARGEST_TURN_RAD)
        balance = HardeningSpring(
            self.relaxed_um, self.hardening_length_um).start(surroundings)

        def at_rest(level: float) -> Rested:
            balanced_um = balance.rest(level)
            return (level, level - balanced_um, 0.0), balanced_um

        return StateRunner(_swing, at_rest, (
            self.relaxed_um, self.hardening_length_um, self.damping_ratio, turned_rad / steps,
            steps))
