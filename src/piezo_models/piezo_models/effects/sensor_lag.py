# SPDX-License-Identifier: BSD-3-Clause
"""Lag of the sensor, or of the filter behind it."""

from dataclasses import dataclass
from typing import ClassVar, Self

import control

from piezo_models.effects.delay import Delay
from piezo_models.effects.effect import parameter
from piezo_models.effects.filtering import slowed
from piezo_models.effects.lag import Lag

ROUNDED = 0.25

SHARPEST = 1e-6
"""Roundness up to which the lag is taken as of first order in a feedback loop."""


@dataclass(frozen=True)
class SensorLag(Lag):
    """The sensor follows the displacement with a time constant; the stage itself does not lag.

    The lag is 1 / (1 + T s + r (T s)^2): of first order for a roundness r of 0, two equal lags for
    1/4, nearly a delay for 1/2.
    """

    name: ClassVar[str] = "sensor_lag"
    place: ClassVar[str] = "sensor"
    experiment: ClassVar[str] = Delay.experiment
    confounded_with: ClassVar[tuple[str, ...]] = ("delay",)

    roundness: float = parameter("1", "linear", 0.0, 0.5, default=0.0)

    def lag(self) -> control.StateSpace | None:
        """Return the lag as a continuous system, as `Effect.lag` describes."""
        # A much faster second lag would only stiffen the system.
        shape = [self.roundness, 1.0, 1.0] if self.roundness > SHARPEST else [1.0, 1.0]
        return slowed([1.0], shape, self.time_constant_s)

    def _denominator(self) -> list[float]:
        return [self.roundness * self.time_constant_s**2, self.time_constant_s, 1.0]

    @classmethod
    def tried(cls, time_constant_s: float) -> Self:
        """Return a rounded lag with a time constant of the scan."""
        return cls(time_constant_s, ROUNDED)
