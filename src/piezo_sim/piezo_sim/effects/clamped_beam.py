# SPDX-License-Identifier: BSD-3-Clause
"""Beam clamped at both ends, pushed by an actuator at one place, measured at another.

The model has the first three modes phi_k of the Euler-Bernoulli beam with frequencies w_k,
normalised to the length, and the modal mass m of the whole beam. The stiffness s of the actuator
couples them:

    m (q_k'' + 2 zeta_k w_k q_k' + w_k^2 q_k) = s phi_k(x_a) (u - sum_j phi_j(x_a) q_j)

The displacement sum_k phi_k(x_s) q_k is scaled to unit static gain, so that the stroke u applies at
the sensor.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_sim.plant.linear_effects import StateSpace
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, parameter, require

# Roots of cos(x) cosh(x) = 1: wave number times length of the modes.
WAVE_NUMBERS = (4.730040744862704, 7.853204624095838, 10.995607838001671)


def mode_shape(wave_number: float, place: float) -> float:
    """Return the deflection of a mode at `place`, a fraction of the length; mean square one."""
    x = wave_number * place
    ratio = (math.cosh(wave_number) - math.cos(wave_number)) / (
        math.sinh(wave_number) - math.sin(wave_number)
    )
    return math.cosh(x) - math.cos(x) - ratio * (math.sinh(x) - math.sin(x))


@dataclass(frozen=True)
class ClampedBeam(Bounded):
    """Material and dimensions of the beam, modal damping, actuator and sensor on it."""

    name: ClassVar[str] = "clamped_beam"

    length_m: float = parameter("m", POSITIVE)
    thickness_m: float = parameter("m", POSITIVE)
    width_m: float = parameter("m", POSITIVE)
    elastic_modulus_pa: float = parameter("Pa", POSITIVE)
    density_kg_per_m3: float = parameter("kg/m^3", POSITIVE)
    damping_ratios: tuple[float, ...] = parameter("1", POSITIVE)
    actuator_stiffness_n_per_m: float = parameter("N/m", POSITIVE)
    actuator_place: float = parameter("1")
    sensor_place: float = parameter("1")

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.damping_ratios) == len(WAVE_NUMBERS), self,
                "damping_ratios must be three numbers, one for each mode.")
        require(
            0.0 < self.actuator_place < 1.0 and 0.0 < self.sensor_place < 1.0,
            self,
            "actuator_place and sensor_place must be between 0 and 1, parts of the length.",
        )

    def frequencies_rad_per_s(self) -> FloatArray:
        """Return the frequencies of the modes without the actuator, shape (3,)."""
        # Bending stiffness over mass per length, of a rectangle.
        ratio = self.elastic_modulus_pa * self.thickness_m**2 / (12.0 * self.density_kg_per_m3)
        return (np.array(WAVE_NUMBERS) / self.length_m) ** 2 * math.sqrt(ratio)

    def state_space(self) -> StateSpace:
        """Return the system of modal deflections, then velocities over the first frequency."""
        w = self.frequencies_rad_per_s()
        mass = self.density_kg_per_m3 * self.width_m * self.thickness_m * self.length_m
        pushed, seen = (
            np.array([mode_shape(number, place) for number in WAVE_NUMBERS])
            for place in (self.actuator_place, self.sensor_place)
        )
        coupling = self.actuator_stiffness_n_per_m / mass
        stiffness = np.diag(w**2) + coupling * np.outer(pushed, pushed)
        push = coupling * pushed / (seen @ np.linalg.solve(stiffness, coupling * pushed))
        a = np.zeros((6, 6))
        a[:3, 3:] = w[0] * np.eye(3)
        a[3:, :3] = -stiffness / w[0]
        a[3:, 3:] = -np.diag(2.0 * np.array(self.damping_ratios) * w)
        return StateSpace(
            a,
            np.concatenate([np.zeros(3), push / w[0]]),
            np.concatenate([seen, np.zeros(3)]),
            0.0,
        )
