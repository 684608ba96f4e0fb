# SPDX-License-Identifier: BSD-3-Clause
"""Displacement sensor (LVDT) in front of an analogue-to-digital converter."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_sim.plant.converter import converter_of
from piezo_sim.plant.plant_effect import NOT_NEGATIVE, Bounded, Surroundings, parameter
from piezo_sim.plant.random_stream import NormalStream
from piezo_sim.plant.state_runner import StateRunner


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

    def start(self, surroundings: Surroundings) -> StateRunner:
        """Start the noise from the seed; there is no state."""
        converter = converter_of(self, "displacement_min_um", "displacement_max_um")

        def measure(samples: FloatArray, normals: FloatArray) -> tuple[()]:
            samples += self.noise_rms_um * normals
            converter.apply(samples)
            return ()

        return StateRunner(measure, lambda level: ((), level),
                           normals=NormalStream(np.random.PCG64(surroundings.seed)))
