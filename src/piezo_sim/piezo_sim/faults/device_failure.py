# SPDX-License-Identifier: BSD-3-Clause
"""A data acquisition card that breaks down."""

from dataclasses import dataclass
from typing import ClassVar

from piezo_common.arrays import FloatArray
from piezo_sim.faults.window import FaultWindow, require_window
from piezo_sim.plant.plant_effect import Surroundings, parameter
from piezo_stage_driver.backends.backend import BackendFault


@dataclass(frozen=True)
class DeviceFailure:
    """No samples are exchanged any more."""

    name: ClassVar[str] = "device_failure"

    begin_s: float = parameter("s")
    end_s: float = parameter("s")

    def __post_init__(self) -> None:
        require_window(self)

    def start(self, surroundings: Surroundings) -> "DeviceFailureRunner":
        """Wait for the beginning."""
        return DeviceFailureRunner(self, surroundings)


class DeviceFailureRunner(FaultWindow[DeviceFailure]):
    """Device that fails at the beginning of its window."""

    def spoil(self, samples: FloatArray, first: int, last: int) -> None:
        """Raise the fault."""
        raise BackendFault("the simulated device failed: the samples were lost")
