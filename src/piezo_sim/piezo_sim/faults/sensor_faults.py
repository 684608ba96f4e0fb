# SPDX-License-Identifier: BSD-3-Clause
"""Faults of a displacement sensor."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_sim.faults.window import Fault, Spoil
from piezo_sim.plant.plant_effect import POSITIVE, Surroundings, parameter
from piezo_sim.plant.random_stream import NormalStream, bits_for


@dataclass(frozen=True)
class StuckSensor(Fault):
    """The reading does not change any more."""

    name: ClassVar[str] = "stuck_sensor"

    def spoiling(self, surroundings: Surroundings) -> Spoil:
        """Repeat the reading at which the sensor got stuck."""
        stuck_um: list[float] = []

        def spoil(samples: FloatArray) -> None:
            if not stuck_um:
                stuck_um.append(samples[0])
            samples[:] = stuck_um[0]

        return spoil


@dataclass(frozen=True)
class SilentSensor(Fault):
    """The reading is NaN, as of a sensor that does not respond."""

    name: ClassVar[str] = "silent_sensor"

    def spoiling(self, surroundings: Surroundings) -> Spoil:
        """Replace readings by NaN."""
        return lambda samples: samples.fill(np.nan)


@dataclass(frozen=True)
class OffScaleSensor(Fault):
    """The reading is constant, as with a disconnected cable."""

    name: ClassVar[str] = "off_scale_sensor"

    reading_um: float = parameter("um")

    def spoiling(self, surroundings: Surroundings) -> Spoil:
        """Replace readings by the value."""
        return lambda samples: samples.fill(self.reading_um)


@dataclass(frozen=True)
class NoisySensor(Fault):
    """White noise in addition to the sensor's own."""

    name: ClassVar[str] = "noisy_sensor"

    noise_rms_um: float = parameter("um", POSITIVE)

    def spoiling(self, surroundings: Surroundings) -> Spoil:
        """Add noise from the seed to the readings."""
        noise = NormalStream(bits_for(self.name, surroundings.seed))

        def spoil(samples: FloatArray) -> None:
            samples += self.noise_rms_um * noise.next(samples.size)

        return spoil
