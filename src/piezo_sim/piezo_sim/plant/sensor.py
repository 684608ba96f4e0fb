# SPDX-License-Identifier: BSD-3-Clause
"""Displacement sensor (LVDT) in front of an analogue-to-digital converter."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_sim.plant.converter import converter_of
from piezo_sim.plant.plant_effect import NOT_NEGATIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.random_stream import NormalStream


@dataclass(frozen=True)
class DisplacementSensor(Bounded):
    """White Gaussian noise on every sample, then quantisation by the converter."""

    name: ClassVar[str] = "displacement_sensor"

    noise_rms_um: float = parameter("um", NOT_NEGATIVE)
    displacement_min_um: float = parameter("um")
    displacement_max_um: float = parameter("um")
    converter_bits: int = parameter("1")

    def __post_init__(self) -> None:
        super().__post_init__()
        converter_of(self, "displacement_min_um", "displacement_max_um")  # checks the parameters

    def start(self, surroundings: Surroundings) -> "SensorRunner":
        """Start the noise from the seed."""
        return SensorRunner(self, surroundings.seed)


class SensorRunner:
    """Sensor with its noise stream."""

    def __init__(self, effect: DisplacementSensor, seed: int) -> None:
        self._noise_rms_um = effect.noise_rms_um
        self._converter = converter_of(effect, "displacement_min_um", "displacement_max_um")
        self._noise = NormalStream(np.random.PCG64(seed))

    def rest(self, level: float) -> float:
        """Return the level unchanged, as the sensor has no state."""
        return level

    def apply(self, samples: FloatArray) -> None:
        """Replace displacements by measured displacements."""
        samples += self._noise_rms_um * self._noise.next(samples.size)
        self._converter.apply(samples)
