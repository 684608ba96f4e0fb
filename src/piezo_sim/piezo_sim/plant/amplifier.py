# SPDX-License-Identifier: BSD-3-Clause
"""Voltage amplifier behind a digital-to-analogue converter."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.converter import converter_of
from piezo_sim.plant.plant_effect import POSITIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.state_runner import Rested, StateRunner


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

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start at the level of the converter nearest to the rest voltage."""
        converter = converter_of(self, "voltage_min_v", "voltage_max_v")
        largest_change_v = self.slew_rate_v_per_s * surroundings.sample_period_s

        def at_rest(level: float) -> Rested:
            samples = np.array([level])
            converter.apply(samples)
            return (float(samples[0]),), float(samples[0])

        def follow(samples: FloatArray, output_v: float) -> tuple[float]:
            converter.apply(samples)
            return (_slew(samples, output_v, largest_change_v),)

        return StateRunner(follow, at_rest)
