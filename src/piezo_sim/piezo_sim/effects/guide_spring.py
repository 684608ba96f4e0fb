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

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.effects.hardening_spring import HardeningSpring
from piezo_sim.plant.plant_effect import Surroundings, parameter, require

LARGEST_TURN_RAD = 0.05
"""Largest angle in rad by which the mode turns in a step: the midpoint rule then has an error of
1e-4 of the effect of the cube."""


@njit(cache=True)
def _swing(samples: FloatArray, state: FloatArray, relaxed_um: float, length_um: float,
           damping_ratio: float, turn_rad: float, steps: int) -> None:
    before_um, taken_um, speed_um = state
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
    state[0], state[1], state[2] = before_um, taken_um, speed_um


@dataclass(frozen=True)
class GuideSpring:
    """The cubic part of the spring of a mode; place it behind the mode, with the same numbers."""

    name: ClassVar[str] = "guide_spring"

    frequency_rad_per_s: float = parameter("rad/s")
    damping_ratio: float = parameter("1")
    relaxed_um: float = parameter("um")
    hardening_length_um: float = parameter("um")

    def __post_init__(self) -> None:
        require(self.frequency_rad_per_s > 0.0, self, "frequency_rad_per_s must be positive.")
        require(self.damping_ratio > 0.0, self, "damping_ratio must be positive.")
        require(self.hardening_length_um > 0.0, self, "hardening_length_um must be positive.")

    def start(self, surroundings: Surroundings) -> "GuideRunner":
        """Start with a position that `rest` sets."""
        return GuideRunner(self, surroundings)


class GuideRunner:
    """Guide with the displacement that the cube removes, and its velocity over the frequency."""

    def __init__(self, spring: GuideSpring, surroundings: Surroundings) -> None:
        turned_rad = spring.frequency_rad_per_s * surroundings.sample_period_s
        steps = math.ceil(turned_rad / LARGEST_TURN_RAD)
        self._balance = HardeningSpring(
            spring.relaxed_um, spring.hardening_length_um).start(surroundings)
        self._constants = (spring.relaxed_um, spring.hardening_length_um, spring.damping_ratio,
                           turned_rad / steps, steps)
        self._state = np.zeros(3)

    def rest(self, level: float) -> float:
        """Set the equilibrium under the drive `level`; return it."""
        balanced_um = self._balance.rest(level)
        self._state[:] = level, level - balanced_um, 0.0
        return balanced_um

    def apply(self, samples: FloatArray) -> None:
        """Replace displacements of the linear mode by those of the guide."""
        _swing(samples, self._state, *self._constants)
