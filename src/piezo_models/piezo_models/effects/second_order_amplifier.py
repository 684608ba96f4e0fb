# SPDX-License-Identifier: BSD-3-Clause
"""Amplifier of second order, in front of the hysteresis."""

from dataclasses import dataclass
from typing import ClassVar, Self

import control

from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.effect import Evidence, Extent, parameter
from piezo_models.effects.filtering import slowed

LOWEST_QUALITY, HIGHEST_QUALITY = 0.05, 5.0
"""Bounds of a fitted quality factor. At the lower one it is nearly a single lag; an amplifier above
the upper one would be nearly unstable."""


@dataclass(frozen=True)
class SecondOrderAmplifier(AmplifierLag):
    """The voltage at the actuator is the commanded one behind 1 / (1 + T s + (Q T s)^2).

    The time constant T is the delay of slow voltages for any quality factor Q. Q is 1/2 for two
    equal lags, 0.71 for a flat amplitude over frequency without overshoot, and 0 for a single lag.
    """

    name: ClassVar[str] = "second_order_amplifier"
    confounded_with: ClassVar[tuple[str, ...]] = ("amplifier_lag", "delay", "sensor_lag")

    quality_factor: float = parameter("1", "logarithm", LOWEST_QUALITY, 20.0, default=0.5)

    def lag(self) -> control.StateSpace:
        """Return the amplifier as a continuous system, as `Effect.lag` describes."""
        return slowed([1.0], [self.quality_factor**2, 1.0, 1.0], self.time_constant_s)

    @property
    def ringing_s(self) -> float:
        """Return the time constant with which it rings out in s, also of poles that do not ring."""
        ringing_s: float = 2.0 * self.quality_factor**2 * self.time_constant_s
        return ringing_s

    def _denominator(self) -> list[float]:
        time_s: float = self.time_constant_s
        return [(self.quality_factor * time_s) ** 2, time_s, 1.0]

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the quality factor, as well, by what an amplifier can have."""
        return {**super().bounds(extent), "quality_factor": (LOWEST_QUALITY, HIGHEST_QUALITY)}

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Return none: `identify` compares it with an amplifier of first order."""
        return []
