# SPDX-License-Identifier: BSD-3-Clause
"""Ways in which a displacement sensor is lost."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_sim.faults.window import FaultWindow, require_window
from piezo_sim.plant.plant_effect import Surroundings, parameter, require
from piezo_sim.plant.random_stream import NormalStream, bits_for


@dataclass(frozen=True)
class StuckSensor:
    """The reading stays as it is."""

    name: ClassVar[str] = "stuck_sensor"

    begin_s: float = parameter("s")
    end_s: float = parameter("s")

    def __post_init__(self) -> None:
        require_window(self)

    def start(self, surroundings: Surroundings) -> "StuckSensorRunner":
        """Wait for the beginning."""
        return StuckSensorRunner(self, surroundings)


class StuckSensorRunner(FaultWindow[StuckSensor]):
    """Keeps the last good reading."""

    _reading_um: float | None = None

    def spoil(self, samples: FloatArray, first: int, last: int) -> None:
        """Repeat the reading at which the sensor got stuck."""
        if self._at + first == self._begin or self._reading_um is None:
            self._reading_um = samples[first]
        samples[first:last] = self._reading_um


@dataclass(frozen=True)
class SilentSensor:
    """The reading is not a number, as that of a sensor that does not answer."""

    name: ClassVar[str] = "silent_sensor"

    begin_s: float = parameter("s")
    end_s: float = parameter("s")

    def __post_init__(self) -> None:
        require_window(self)

    def start(self, surroundings: Surroundings) -> "SilentSensorRunner":
        """Wait for the beginning."""
        return SilentSensorRunner(self, surroundings)


class SilentSensorRunner(FaultWindow[SilentSensor]):
    """Replace the readings of a silent sensor by NaN."""

    def spoil(self, samples: FloatArray, first: int, last: int) -> None:
        """Replace readings by NaN."""
        samples[first:last] = np.nan


@dataclass(frozen=True)
class OffScaleSensor:
    """The reading sits at one value, as that of a cable that came off."""

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
    """Reads one value."""

    def spoil(self, samples: FloatArray, first: int, last: int) -> None:
        """Replace readings by the value."""
        samples[first:last] = self.effect.reading_um


@dataclass(frozen=True)
class NoisySensor:
    """White noise on top of the sensor's own."""

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
    """Add noise from the seed to the readings of a noisy sensor."""

    def __init__(self, effect: NoisySensor, surroundings: Surroundings) -> None:
        super().__init__(effect, surroundings)
        self._noise = NormalStream(bits_for(effect.name, surroundings.seed))

    def spoil(self, samples: FloatArray, first: int, last: int) -> None:
        """Add noise to the readings."""
        samples[first:last] += self.effect.noise_rms_um * self._noise.next(last - first)
