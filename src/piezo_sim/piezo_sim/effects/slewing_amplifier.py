# SPDX-License-Identifier: BSD-3-Clause
"""Power amplifier of two poles in a feedback loop, whose first stage saturates.

::

    dv/dt = z,   dz/dt = 2 zeta w (sat(w / (2 zeta) (u - v), S) - z)

For small signals v'' + 2 zeta w v' + w^2 v = w^2 u; for large ones ``|dv/dt|`` stays below the slew
rate S. The loop is advanced in steps of a fraction of a sample, each exact for the regime, linear
or saturated, in which it begins. The output is the mean over the sample, to which the following
effects respond.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit
from scipy.linalg import expm

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.state_runner import StateRunner

# Steps per sample; the regime is chosen anew at each of them.
STEPS = 8


@njit(cache=True)
def _follow(samples: FloatArray, output_v: float, slope_v_per_s: float, steps: int,
            linear: FloatArray, saturated: FloatArray, gain_per_s: float,
            slew_v_per_s: float) -> tuple[float, float]:
    """Advance the amplifier; rows of the matrices are new output, new slope and integral."""
    for n in range(samples.size):
        target_v = samples[n]
        integral = 0.0
        for _ in range(steps):
            wanted = gain_per_s * (target_v - output_v)
            if abs(wanted) <= slew_v_per_s:
                matrix, drive = linear, target_v
            else:
                matrix, drive = saturated, (slew_v_per_s if wanted > 0.0 else -slew_v_per_s)
            integral += matrix[2, 0] * output_v + matrix[2, 1] * slope_v_per_s
            integral += matrix[2, 2] * drive
            following_v = matrix[0, 0] * output_v + matrix[0, 1] * slope_v_per_s
            following_v += matrix[0, 2] * drive
            slope_v_per_s = (
                matrix[1, 0] * output_v + matrix[1, 1] * slope_v_per_s + matrix[1, 2] * drive
            )
            output_v = following_v
        samples[n] = integral
    return output_v, slope_v_per_s


@dataclass(frozen=True)
class SlewingAmplifier(Bounded):
    """Bandwidth, damping and slew rate of the amplifier with its load."""

    name: ClassVar[str] = "slewing_amplifier"

    natural_frequency_rad_per_s: float = parameter("rad/s", POSITIVE)
    damping_ratio: float = parameter("1", POSITIVE)
    slew_rate_v_per_s: float = parameter("V/s", POSITIVE)

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start with the voltage that `rest` sets, and without slope."""
        w, zeta = self.natural_frequency_rad_per_s, self.damping_ratio
        step_s = surroundings.sample_period_s / STEPS
        return StateRunner(_follow, lambda level: ((level, 0.0), level), (
            STEPS, _step_matrix(-w * w, -2.0 * zeta * w, w * w, step_s),
            _step_matrix(0.0, -2.0 * zeta * w, 2.0 * zeta * w, step_s), w / (2.0 * zeta),
            self.slew_rate_v_per_s))


def _step_matrix(stiffness: float, friction: float, drive: float, step_s: float) -> FloatArray:
    """Return the exact step of v' = z, z' = stiffness v + friction z + drive u, with its mean."""
    augmented = np.zeros((4, 4))
    augmented[0, 1] = 1.0
    augmented[1] = stiffness, friction, 0.0, drive
    augmented[2, 0] = 1.0 / (STEPS * step_s)
    return np.ascontiguousarray(expm(augmented * step_s)[:3][:, [0, 1, 3]])
