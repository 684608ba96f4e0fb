# SPDX-License-Identifier: BSD-3-Clause
"""Drift with the temperature of the surroundings, whatever the voltage."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_models.effects.effect import Effect, parameter

VISIBLE = 0.005
"""Part of a steady drift that unknown creep must leave to be seen."""


@dataclass(frozen=True)
class ThermalDrift(Effect):
    """A constant rate, and an approach to a new temperature."""

    name: ClassVar[str] = "thermal_drift"
    place: ClassVar[str] = "displacement"
    follows_voltage: ClassVar[bool] = False
    experiment: ClassVar[str] = "rest for minutes, and the same waveform repeated at later times"

    rate_um_per_s: float = parameter("um/s")
    approach_um: float = parameter("um")
    time_constant_s: float = parameter("s", "logarithm", 1e-3, 1e9)

    def apply(self, signal, sample_period_s, rest=None):
        """See `Effect.apply`."""
        time_s = np.arange(signal.size) * sample_period_s
        return signal + self._drifts(time_s) @ (self.rate_um_per_s, self.approach_um)

    def _drifts(self, time_s):
        return np.column_stack([time_s, -np.expm1(-time_s / self.time_constant_s)])

    @classmethod
    def starts(cls, evidence):
        """The best of a few time constants."""
        shapes = [
            cls(0.0, 0.0, part * evidence.duration_s) for part in (0.1, 0.3, 1.0)
        ]
        found = evidence.best(shapes, lambda shape: shape._drifts(evidence.time_s), count=2)
        return [cls(*gains, shape.time_constant_s) for shape, gains in found]

    @classmethod
    def lacks_excitation(cls, evidence):
        """A short drift looks like creep that had begun before."""
        if evidence.visible(evidence.time_s[:, None]) < VISIBLE:
            return "in so short a time, a drift looks like creep that had begun before"
        return None
