# SPDX-License-Identifier: BSD-3-Clause
"""Digital-to-analogue converter that holds each level until the next update."""

from dataclasses import dataclass
from typing import ClassVar

from piezo_sim.plant.converter import converter_of
from piezo_sim.plant.plant_effect import Surroundings, parameter
from piezo_sim.plant.pointwise import PointwiseRunner


@dataclass(frozen=True)
class OutputConverter:
    """Range and levels of the converter, in volts at the output of the amplifier behind it."""

    name: ClassVar[str] = "output_converter"

    voltage_min_v: float = parameter("V")
    voltage_max_v: float = parameter("V")
    converter_bits: int = parameter("1")

    def __post_init__(self) -> None:
        converter_of(self, "voltage_min_v", "voltage_max_v")  # checks the parameters

    def start(self, surroundings: Surroundings) -> PointwiseRunner:
        """Start; a converter has no memory."""
        return PointwiseRunner(converter_of(self, "voltage_min_v", "voltage_max_v").apply)
