# SPDX-License-Identifier: BSD-3-Clause
"""Limited current of the amplifier into the capacitance of the actuator.

The capacitance grows with the voltage, and the limits of source and sink current may differ, so
that the slew rate depends on voltage and direction.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.state_runner import StateRunner, unmoved


@njit(cache=True)
def _charge(samples: FloatArray, output_v: float, period_s: float, source_v_per_s: float,
            sink_v_per_s: float, growth_per_v: float) -> tuple[float]:
    for n in range(samples.size):
        change_v = samples[n] - output_v
        if change_v == 0.0:
            continue
        fastest = source_v_per_s if change_v > 0.0 else sink_v_per_s
        rate_v_per_s = math.copysign(fastest, change_v) * math.exp(-growth_per_v * output_v)
        charging_s = change_v / rate_v_per_s
        if charging_s < period_s:
            output_v = samples[n]
        else:
            charging_s = period_s
            output_v += rate_v_per_s * period_s
        # The mean over the sample, whose first part is a ramp.
        samples[n] = output_v - 0.5 * rate_v_per_s * charging_s * charging_s / period_s
    return (output_v,)


@dataclass(frozen=True)
class CurrentLimit(Bounded):
    """Largest currents into and out of a capacitance C(v) = capacitance exp(growth v)."""

    name: ClassVar[str] = "current_limit"

    source_current_a: float = parameter("A", POSITIVE)
    sink_current_a: float = parameter("A", POSITIVE)
    capacitance_f: float = parameter("F", POSITIVE)
    capacitance_growth_per_v: float = parameter("1/V")

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start with the voltage at the actuator that `rest` sets."""
        return StateRunner(_charge, unmoved, (
            surroundings.sample_period_s, self.source_current_a / self.capacitance_f,
            self.sink_current_a / self.capacitance_f, self.capacitance_growth_per_v))
