# SPDX-License-Identifier: BSD-3-Clause
"""Amplifier that does not reach the voltages asked for."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_models.effects.effect import Effect, parameter

SCANNED_PARTS = (0.02, 0.05, 0.1, 0.2)


@dataclass(frozen=True)
class VoltageClipping(Effect):
    """Voltages beyond two limits come out as the limits."""

    name: ClassVar[str] = "voltage_clipping"
    place: ClassVar[str] = "voltage"
    experiment: ClassVar[str] = "hysteresis: harmonics over the whole range"

    lowest_v: float = parameter("V")
    highest_v: float = parameter("V")

    def apply(self, signal, sample_period_s, rest=None):
        """See `Effect.apply`."""
        return np.clip(signal, self.lowest_v, max(self.lowest_v, self.highest_v))

    def compensate(self, wanted, sample_period_s):
        """The wanted voltage itself, if it lies within the limits."""
        if wanted.min() < self.lowest_v or wanted.max() > self.highest_v:
            raise ValueError(
                f"the voltage would go from {wanted.min():.6g} to {wanted.max():.6g} V, the "
                f"amplifier gives {self.lowest_v:.6g} to {self.highest_v:.6g} V: ask for less"
            )
        return wanted

    @classmethod
    def starts(cls, evidence):
        """Limits at some parts of the span from its ends."""
        low, high = evidence.voltage_v.min(), evidence.voltage_v.max()
        span = high - low
        starts = [cls(low, high - part * span) for part in SCANNED_PARTS]
        return starts + [cls(low + part * span, high) for part in SCANNED_PARTS]

    @classmethod
    def lacks_excitation(cls, evidence):
        """Nothing is clipped of a voltage that hardly changes."""
        if np.ptp(evidence.voltage_v) == 0.0:
            return "the voltage does not change"
        return None
