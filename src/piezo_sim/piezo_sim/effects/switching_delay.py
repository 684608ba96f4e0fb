# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis whose relays switch later the faster the voltage changes.

Switching is thermally activated: the coercive voltage grows with the logarithm of the rate. If all
thresholds move equally, upwards in a rise and downwards in a fall, this is equivalent to a voltage
reduced by that shift.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.state_runner import StateRunner


@njit(cache=True)
def _shift(samples: FloatArray, previous_v: float, speed_v_per_s: float, period_s: float,
           share: float, shift_v: float, reference_v_per_s: float) -> tuple[float, float]:
    for n in range(samples.size):
        change_v = samples[n] - previous_v
        previous_v = samples[n]
        speed_v_per_s += share * (change_v / period_s - speed_v_per_s)
        samples[n] = previous_v - shift_v * math.asinh(speed_v_per_s / reference_v_per_s)
    return previous_v, speed_v_per_s


@dataclass(frozen=True)
class SwitchingDelay(Bounded):
    """Thresholds shifted by shift arsinh(speed / reference), the speed averaged over a short time.

    Place it before the hysteresis.
    """

    name: ClassVar[str] = "switching_delay"

    threshold_shift_v: float = parameter("V")
    reference_speed_v_per_s: float = parameter("V/s", POSITIVE)
    averaging_time_s: float = parameter("s", POSITIVE)

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start with the voltage that `rest` sets, and without speed."""
        period_s = surroundings.sample_period_s
        return StateRunner(_shift, lambda level: ((level, 0.0), level), (
            period_s, -math.expm1(-period_s / self.averaging_time_s), self.threshold_shift_v,
            self.reference_speed_v_per_s))
