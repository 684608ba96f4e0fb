# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis whose relays switch later the faster the voltage changes.

Switching is thermally activated: the coercive voltage grows with the logarithm of the rate. When
all thresholds move alike, upwards in a rise and downwards in a fall, hysteresis sees the voltage
reduced by that shift.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from piezo_sim.effect import Surroundings, parameter, require


@njit(cache=True)
def _shift(samples, previous_v, speed_v_per_s, period_s, share, shift_v, reference_v_per_s):
    for n in range(samples.size):
        change_v = samples[n] - previous_v
        previous_v = samples[n]
        speed_v_per_s += share * (change_v / period_s - speed_v_per_s)
        samples[n] = previous_v - shift_v * math.asinh(speed_v_per_s / reference_v_per_s)
    return previous_v, speed_v_per_s


@dataclass(frozen=True)
class SwitchingDelay:
    """Thresholds shifted by shift arsinh(speed / reference), the speed averaged over a short time.

    To stand before the hysteresis.
    """

    name: ClassVar[str] = "switching_delay"

    threshold_shift_v: float = parameter("V")
    reference_speed_v_per_s: float = parameter("V/s")
    averaging_time_s: float = parameter("s")

    def __post_init__(self):
        require(
            self.reference_speed_v_per_s > 0.0, self, "reference_speed_v_per_s must be positive."
        )
        require(self.averaging_time_s > 0.0, self, "averaging_time_s must be positive.")

    def start(self, surroundings: Surroundings) -> "SwitchingDelayRunner":
        """Start with a voltage to be set by `rest`."""
        return SwitchingDelayRunner(self, surroundings.sample_period_s)


class SwitchingDelayRunner:
    """Switching delay with the present voltage and speed."""

    def __init__(self, effect: SwitchingDelay, sample_period_s: float):
        self._state = (0.0, 0.0)
        self._constants = (
            sample_period_s,
            -math.expm1(-sample_period_s / effect.averaging_time_s),
            effect.threshold_shift_v,
            effect.reference_speed_v_per_s,
        )

    def rest(self, level: float) -> float:
        """Stand still at the voltage `level`."""
        self._state = (level, 0.0)
        return level

    def apply(self, samples: np.ndarray) -> None:
        """Replace voltages by those that the hysteresis sees."""
        self._state = _shift(samples, *self._state, *self._constants)
