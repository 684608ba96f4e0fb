# SPDX-License-Identifier: BSD-3-Clause
"""A vibration mode that carries a load from a given time on.

A mass or a spring is attached to the moving part, given in parts of its own mass and stiffness; the
viscous damping is unchanged. A negative part is removed.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_sim.plant.linear_effects import StateSpace, VibrationMode
from piezo_sim.plant.plant_effect import NOT_NEGATIVE, POSITIVE, Bounded, parameter, require


@dataclass(frozen=True)
class LoadedMode(Bounded):
    """A mode m x'' + c x' + k x = k u whose m and k change at a given time.

    After that it is (m + dm) x'' + c x' + (k + dk) x = k u: with dm the mode is slower, with dk
    faster and less compliant. Position and velocity are continuous.
    """

    name: ClassVar[str] = "loaded_mode"

    frequency_rad_per_s: float = parameter("rad/s", POSITIVE)
    damping_ratio: float = parameter("1", POSITIVE)
    added_mass: float = parameter("1")
    added_stiffness: float = parameter("1")
    begin_s: float = parameter("s", NOT_NEGATIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(min(self.added_mass, self.added_stiffness) > -1.0, self,
                "added_mass and added_stiffness must be above -1, parts of the mode's own.")

    def state_space(self) -> StateSpace:
        """Return the mode without the load, in position and velocity / w."""
        return VibrationMode(self.frequency_rad_per_s, self.damping_ratio).state_space()

    def changed(self) -> StateSpace:
        """Return the mode with the load; its states are those without it."""
        w, inertia = self.frequency_rad_per_s, 1.0 + self.added_mass
        a = np.array([[0.0, w], [-w * (1.0 + self.added_stiffness) / inertia,
                                 -2.0 * self.damping_ratio * w / inertia]])
        return StateSpace(a, np.array([0.0, w / inertia]), np.array([1.0, 0.0]), 0.0)
