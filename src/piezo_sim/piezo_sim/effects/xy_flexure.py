# SPDX-License-Identifier: BSD-3-Clause
"""A platform on leaf springs with one actuator for each of two directions.

It moves in x, in y and in yaw about its centre of mass. Each actuator is a spring between the frame
and the platform, which pushes slightly askew and off the centre. The leaf springs are not quite
parallel to the axes. All three modes therefore move both axes.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_sim.plant.mechanism import Mechanism
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, parameter, require


@dataclass(frozen=True)
class XYFlexure(Bounded):
    """Masses, springs and directions; lists hold a value for x, then one for y."""

    name: ClassVar[str] = "xy_flexure"
    axes: ClassVar[int] = 2

    mass_kg: float = parameter("kg", POSITIVE)
    inertia_kg_m2: float = parameter("kg m^2", POSITIVE)
    suspension_n_per_m: tuple[float, ...] = parameter("N/m", POSITIVE)
    suspension_cross_n_per_m: float = parameter("N/m")
    suspension_yaw_n_m_per_rad: float = parameter("N m/rad", POSITIVE)
    actuators_n_per_m: tuple[float, ...] = parameter("N/m", POSITIVE)
    actuators_askew_rad: tuple[float, ...] = parameter("rad")
    actuators_beside_m: tuple[float, ...] = parameter("m")
    sensors_askew_rad: tuple[float, ...] = parameter("rad")
    sensors_beside_m: tuple[float, ...] = parameter("m")
    damping_ratios: tuple[float, ...] = parameter("1", POSITIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        for listed in ("suspension_n_per_m", "actuators_n_per_m", "actuators_askew_rad",
                       "actuators_beside_m", "sensors_askew_rad", "sensors_beside_m"):
            require(len(getattr(self, listed)) == 2, self, f"{listed} must be two numbers.")
        require(self.suspension_cross_n_per_m**2 < math.prod(self.suspension_n_per_m), self,
                "suspension_cross_n_per_m must leave the suspension stable.")
        require(len(self.damping_ratios) == 3, self,
                "damping_ratios must be three numbers, one for each mode.")

    def mechanism(self) -> Mechanism:
        """Return the matrices of x, y and yaw (um and urad)."""
        stiffness = np.diag([*self.suspension_n_per_m, self.suspension_yaw_n_m_per_rad])
        stiffness[0, 1] = stiffness[1, 0] = self.suspension_cross_n_per_m
        ways = _directions(self.actuators_askew_rad, self.actuators_beside_m)
        push = ways.T * self.actuators_n_per_m
        return Mechanism(
            np.diag([self.mass_kg, self.mass_kg, self.inertia_kg_m2]), stiffness + push @ ways,
            push, np.eye(2, 3), _directions(self.sensors_askew_rad, self.sensors_beside_m),
            np.array(self.damping_ratios))


def _directions(askew_rad: tuple[float, ...], beside_m: tuple[float, ...]) -> np.ndarray:
    """Return the motion along two lines due to x, y and yaw, shape (2, 3)."""
    (x, y), cosines, sines = beside_m, np.cos(askew_rad), np.sin(askew_rad)
    return np.array([[cosines[0], sines[0], x], [-sines[1], cosines[1], y]])
