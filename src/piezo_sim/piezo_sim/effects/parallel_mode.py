# SPDX-License-Identifier: BSD-3-Clause
"""A vibration mode in parallel with others, as the modes of a structure add up."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_sim.plant.linear_effects import StateSpace, VibrationMode
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, parameter, require


@dataclass(frozen=True)
class ParallelMode(Bounded):
    """A mode with a share of the static compliance, in parallel with the effects before it.

    With the mode M = w^2 / (s^2 + 2 zeta w s + w^2) the effects G become (1 - share) G + share M:
    the static gain is unchanged. A mode with a negative share moves against the others.
    """

    name: ClassVar[str] = "parallel_mode"

    frequency_rad_per_s: float = parameter("rad/s", POSITIVE)
    damping_ratio: float = parameter("1", POSITIVE)
    compliance_share: float = parameter("1")
    beside: int = parameter("1")

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            -1.0 < self.compliance_share < 1.0,
            self,
            "compliance_share must be between -1 and 1.",
        )
        require(self.beside >= 1, self, "beside must be an integer of at least 1.")

    def state_space(self) -> StateSpace:
        """Return the dynamics of the mode alone."""
        return VibrationMode(self.frequency_rad_per_s, self.damping_ratio).state_space()

    def join(self, others: StateSpace) -> StateSpace:
        """Return the parallel connection of the mode and the others."""
        mode, share, n = self.state_space(), self.compliance_share, others.b.size
        a = np.zeros((n + 2, n + 2))
        a[:n, :n] = others.a
        a[n:, n:] = mode.a
        return StateSpace(
            a,
            np.concatenate([others.b, mode.b]),
            np.concatenate([(1.0 - share) * others.c, share * mode.c]),
            (1.0 - share) * others.d,
        )
