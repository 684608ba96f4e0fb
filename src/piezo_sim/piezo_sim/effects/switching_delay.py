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
from piezo_sim.plant.accumulating import AccumulatingRunner
from piezo_sim.plant.plant_effect import Surroundings, parameter, require


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
class SwitchingDelay:
    """Thresholds shifted by shift arsinh(speed / reference), the speed averaged over a short time.

    Place it before the hysteresis.
    """

    name: ClassVar[str] = "switching_delay"

    threshold_shift_v: float = parameter("V")
    reference_speed_v_per_s: float = parameter("V/s")
    averaging_time_s: float = parameter("s")

    def __post_init__(self) -> None:
        require(
            self.reference_speed_v_per_s > 0.0, self, "reference_speed_v_per_s must be positive."
        )
        require(self.averaging_time_s > 0.0, self, "averaging_time_s must be positive.")

    def start(self, surroundings: Surroundings) -> AccumulatingRunner:
        """Start with a voltage that `rest` sets; the accumulated quantity is the averaged speed."""
        return AccumulatingRunner(
            _shift,
            surroundings.sample_period_s,
            -math.expm1(-surroundings.sample_period_s / self.averaging_time_s),
            self.threshold_shift_v,
            self.reference_speed_v_per_s,
        )
