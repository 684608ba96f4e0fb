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
from piezo_sim.plant.plant_effect import Surroundings, parameter, require


@njit(cache=True)
def _charge(samples: FloatArray, output_v: float, period_s: float, source_v_per_s: float,
            sink_v_per_s: float, growth_per_v: float) -> float:
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
    return output_v


@dataclass(frozen=True)
class CurrentLimit:
    """Largest currents into and out of a capacitance C(v) = capacitance exp(growth v)."""

    name: ClassVar[str] = "current_limit"

    source_current_a: float = parameter("A")
    sink_current_a: float = parameter("A")
    capacitance_f: float = parameter("F")
    capacitance_growth_per_v: float = parameter("1/V")

    def __post_init__(self) -> None:
        require(
            self.source_current_a > 0.0 and self.sink_current_a > 0.0,
            self,
            "source_current_a and sink_current_a must be positive.",
        )
        require(self.capacitance_f > 0.0, self, "capacitance_f must be positive.")

    def start(self, surroundings: Surroundings) -> "CurrentLimitRunner":
        """Start with a voltage that `rest` sets."""
        return CurrentLimitRunner(self, surroundings.sample_period_s)


class CurrentLimitRunner:
    """Current limit with the voltage at the actuator as its state."""

    def __init__(self, effect: CurrentLimit, sample_period_s: float) -> None:
        self._output_v = 0.0
        self._constants = (
            sample_period_s,
            effect.source_current_a / effect.capacitance_f,
            effect.sink_current_a / effect.capacitance_f,
            effect.capacitance_growth_per_v,
        )

    def rest(self, level: float) -> float:
        """Settle at the voltage `level`."""
        self._output_v = level
        return level

    def apply(self, samples: FloatArray) -> None:
        """Replace voltages by their means over each sample."""
        self._output_v = _charge(samples, self._output_v, *self._constants)
