# SPDX-License-Identifier: BSD-3-Clause
"""A slow carriage in y that carries a fast platform in x.

The carriage moves in y, is compliant in x, and yaws. The platform slides on it along x; its
actuator is mounted on the carriage, which takes the reaction. No mode belongs to one axis alone,
and the platform's mass, off the carriage's centre, couples them.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_sim.plant.mechanism import Mechanism
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, parameter, require


@dataclass(frozen=True)
class SerialStage(Bounded):
    """Masses, springs and places; the platform's place is relative to the carriage's centre."""

    name: ClassVar[str] = "serial_stage"
    axes: ClassVar[int] = 2

    carriage_mass_kg: float = parameter("kg", POSITIVE)
    carriage_inertia_kg_m2: float = parameter("kg m^2", POSITIVE)
    platform_mass_kg: float = parameter("kg", POSITIVE)
    platform_inertia_kg_m2: float = parameter("kg m^2", POSITIVE)
    platform_place_m: tuple[float, ...] = parameter("m")
    guide_n_per_m: tuple[float, ...] = parameter("N/m", POSITIVE)
    guide_cross_n_per_m: float = parameter("N/m")
    guide_yaw_n_m_per_rad: float = parameter("N m/rad", POSITIVE)
    platform_springs_n_per_m: float = parameter("N/m", POSITIVE)
    platform_askew_rad: float = parameter("rad")
    actuators_n_per_m: tuple[float, ...] = parameter("N/m", POSITIVE)
    slow_actuator_beside_m: float = parameter("m")
    sensors_askew_rad: tuple[float, ...] = parameter("rad")
    damping_ratios: tuple[float, ...] = parameter("1", POSITIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        for listed in ("platform_place_m", "guide_n_per_m", "actuators_n_per_m",
                       "sensors_askew_rad"):
            require(len(getattr(self, listed)) == 2, self, f"{listed} must be two numbers.")
        require(self.guide_cross_n_per_m**2 < math.prod(self.guide_n_per_m), self,
                "guide_cross_n_per_m must leave the guide stable.")
        require(len(self.damping_ratios) == 4, self,
                "damping_ratios must be four numbers, one for each mode.")

    def mechanism(self) -> Mechanism:
        """Return the matrices of the carriage in x, y and yaw, and of the platform on it (um)."""
        along = np.array([np.cos(self.platform_askew_rad), np.sin(self.platform_askew_rad)])
        x, y = self.platform_place_m
        # Position of the platform as a function of the four coordinates.
        platform = np.array([[1.0, 0.0, -y, along[0]], [0.0, 1.0, x, along[1]]])
        mass = (np.diag([self.carriage_mass_kg, self.carriage_mass_kg,
                         self.carriage_inertia_kg_m2 + self.platform_inertia_kg_m2, 0.0])
                + self.platform_mass_kg * platform.T @ platform)
        stiffness = np.diag([*self.guide_n_per_m, self.guide_yaw_n_m_per_rad,
                             self.platform_springs_n_per_m])
        stiffness[0, 1] = stiffness[1, 0] = self.guide_cross_n_per_m
        ways = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 1.0, self.slow_actuator_beside_m, 0.0]])
        push = ways.T * self.actuators_n_per_m
        (x, y) = self.sensors_askew_rad
        seen = np.array([[np.cos(x), np.sin(x)], [-np.sin(y), np.cos(y)]])
        return Mechanism(mass, stiffness + push @ ways, push, platform, seen @ platform,
                         np.array(self.damping_ratios))
