# SPDX-License-Identifier: BSD-3-Clause
"""Voltage amplifier behind a digital-to-analogue converter."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.converter import converter_of
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter


@njit(cache=True)
def _slew(samples: FloatArray, output_v: float, largest_change_v: float) -> float:
    for n in range(samples.size):
        change_v = samples[n] - output_v
        if change_v > largest_change_v:
            output_v += largest_change_v
        elif change_v < -largest_change_v:
            output_v -= largest_change_v
        else:
            output_v = samples[n]
        samples[n] = output_v
    return output_v


@dataclass(frozen=True)
class VoltageAmplifier(Bounded):
    """Range, resolution and slew rate of the amplifier.

    The slew rate limits the change from one sample to the next; the output is held within a sample.
    """

    name: ClassVar[str] = "voltage_amplifier"

    voltage_min_v: float = parameter("V")
    voltage_max_v: float = parameter("V")
    converter_bits: int = parameter("1")
    slew_rate_v_per_s: float = parameter("V/s", POSITIVE)

    def __post_init__(self) -> None:
        super().__post_init__()
        converter_of(self, "voltage_min_v", "voltage_max_v")  # checks the parameters

    def start(self, surroundings: Surroundings) -> "AmplifierRunner":
        """Start at the rest voltage."""
        return AmplifierRunner(self, surroundings.sample_period_s)


class AmplifierRunner:
    """Amplifier with its output as state."""

    def __init__(self, effect: VoltageAmplifier, sample_period_s: float) -> None:
        self._converter = converter_of(effect, "voltage_min_v", "voltage_max_v")
        self._largest_change_v = effect.slew_rate_v_per_s * sample_period_s
        self._output_v = effect.voltage_min_v

    def rest(self, level: float) -> float:
        """Settle at the level of the converter nearest to the command `level`."""
        samples = np.array([level])
        self._converter.apply(samples)
        self._output_v = float(samples[0])
        return self._output_v

    def apply(self, samples: FloatArray) -> None:
        """Replace commanded voltages by output voltages."""
        self._converter.apply(samples)
        self._output_v = _slew(samples, self._output_v, self._largest_change_v)
