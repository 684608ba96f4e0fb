# SPDX-License-Identifier: BSD-3-Clause
"""A data acquisition card that breaks down."""

from dataclasses import dataclass
from typing import ClassVar

from piezo_common.arrays import FloatArray
from piezo_sim.faults.window import Fault, Spoil
from piezo_sim.plant.plant_effect import Surroundings
from piezo_stage_driver.backends.backend import BackendFault


@dataclass(frozen=True)
class DeviceFailure(Fault):
    """No samples are exchanged any more."""

    name: ClassVar[str] = "device_failure"

    def spoiling(self, surroundings: Surroundings) -> Spoil:
        """Raise the fault."""
        def spoil(samples: FloatArray) -> None:
            raise BackendFault("the simulated device failed: the samples were lost")

        return spoil
