# SPDX-License-Identifier: BSD-3-Clause
"""Faults of a displacement sensor."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_sim.faults.window import FaultWindow, require_window
from piezo_sim.plant.plant_effect import Surroundings, parameter, require
from piezo_sim.plant.random_stream import NormalStream, bits_for


@dataclass(frozen=True)
class StuckSensor:
    """The reading does not change any more."""

    name: ClassVar[str] = "stuck_sensor"

    begin_s: float = parameter("s")
    end_s: float = parameter("s")

    def __post_init__(self) -> None:
        require_window(self)

    def start(self, surroundings: Surroundings) -> "StuckSensorRunner":
        """Wait for the beginning."""
        return StuckSensorRunner(self, surroundings)


class StuckSensorRunner(FaultWindow[StuckSensor]):
    """Sensor that repeats its last good reading."""

    _reading_um: float | None = None

    def spoil(self, samples: FloatArray, first: int, last: int) -> None:
        """Repeat the reading at which the sensor got stuck."""
        if self._at + first == self._begin or self._reading_um is None:
            self._reading_um = samples[first]
        samples[first:last] = self._reading_um


@dataclass(frozen=True)
class SilentSensor:
    """The reading is NaN, as of a sensor that does not respond."""

    name: ClassVar[str] = "silent_sensor"

    begin_s: float = parameter("s")
    end_s: float = parameter("s")

    def __post_init__(self) -> None:
        require_window(self)

    def start(self, surroundings: Surroundings) -> "SilentSensorRunner":
        """Wait for the beginning."""
        return SilentSensorRunner(self, surroundings)


class SilentSensorRunner(FaultWindow[SilentSensor]):
    """Sensor whose readings are NaN."""

    def spoil(self, samples: FloatArray, first: int, last: int) -> None:
        """Replace readings by NaN."""
        samples[first:last] = np.nan


@dataclass(frozen=True)
class OffScaleSensor:
    """The reading is constant, as with a disconnected cable."""

    name: ClassVar[str] = "off_scale_sensor"

    begin_s: float = parameter("s")
    end_s: float = parameter("s")
    reading_um: float = parameter("um")

    def __post_init__(self) -> None:
        require_window(self)

    def start(self, surroundings: Surroundings) -> "OffScaleSensorRunner":
        """Wait for the beginning."""
        return OffScaleSensorRunner(self, surroundings)


class OffScaleSensorRunner(FaultWindow[OffScaleSensor]):
    """Sensor with a constant reading."""

    def spoil(self, samples: FloatArray, first: int, last: int) -> None:
        """Replace readings by the value."""
        samples[first:last] = self.effect.reading_um


@dataclass(frozen=True)
class NoisySensor:
    """White noise in addition to the sensor's own."""

    name: ClassVar[str] = "noisy_sensor"

    begin_s: float = parameter("s")
    end_s: float = parameter("s")
    noise_rms_um: float = parameter("um")

    def __post_init__(self) -> None:
        require_window(self)
        require(self.noise_rms_um > 0.0, self, "noise_rms_um must be positive.")

    def start(self, surroundings: Surroundings) -> "NoisySensorRunner":
        """Wait for the beginning."""
        return NoisySensorRunner(self, surroundings)


class NoisySensorRunner(FaultWindow[NoisySensor]):
    """Sensor with additional noise from the seed."""

    def __init__(self, effect: NoisySensor, surroundings: Surroundings) -> None:
        super().__init__(effect, surroundings)
        self._noise = NormalStream(bits_for(effect.name, surroundings.seed))

    def spoil(self, samples: FloatArray, first: int, last: int) -> None:
        """Add noise to the readings."""
        samples[first:last] += self.effect.noise_rms_um * self._noise.next(last - first)
