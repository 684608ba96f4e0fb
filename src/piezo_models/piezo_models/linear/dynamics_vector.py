# SPDX-License-Identifier: BSD-3-Clause
"""The parameters of electric and vibration dynamics as one vector, and back."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray
from piezo_models.linear.dynamics import ElectricVibrationDynamics


def dynamics_vector(dynamics: ElectricVibrationDynamics) -> FloatArray:
    """Parameters of electric and vibration dynamics in one vector, all positive."""
    return np.array([
        dynamics.time_constant_s, *dynamics.mode_frequencies_rad_per_s, *dynamics.damping_ratios,
        *dynamics.antiresonance_frequencies_rad_per_s, *dynamics.antiresonance_damping_ratios,
    ])


def split_dynamics_vector(
    vector: ArrayLike, mode_count: int, antiresonance_count: int = 0,
) -> dict[str, Any]:
    """Fields of `ElectricVibrationDynamics` by name, from a vector in their order."""
    edges = np.cumsum([1, mode_count, mode_count, antiresonance_count])
    parts = np.split(np.asarray(vector, dtype=float), edges)
    names = ("mode_frequencies_rad_per_s", "damping_ratios",
             "antiresonance_frequencies_rad_per_s", "antiresonance_damping_ratios")
    return {"time_constant_s": float(parts[0][0])} | {
        name: tuple(part.tolist()) for name, part in zip(names, parts[1:], strict=True)
    }


def dynamics_of_vector(
    vector: ArrayLike, mode_count: int, antiresonance_count: int = 0,
) -> ElectricVibrationDynamics:
    """Inverse of `dynamics_vector`."""
    return ElectricVibrationDynamics(
        **split_dynamics_vector(vector, mode_count, antiresonance_count)
    )
