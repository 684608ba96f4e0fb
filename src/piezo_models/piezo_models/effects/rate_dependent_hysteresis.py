# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis that widens with the speed."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from piezo_models.effects.effect import Effect, parameter

SCANNED_EXPONENTS = (0.02, 0.3, 0.6)
SCANNED_SPEEDS = np.geomspace(1e-4, 1.0, 7)
"""Of the largest."""


@dataclass(frozen=True)
class RateDependentHysteresis(Effect):
    """The displacement stays behind by a compressive function of its speed.

    By widening_um ((1 + speed / onset)^exponent - 1) / exponent: an exponent of 1 would be a lag,
    one near 0 is a logarithm.
    """

    name: ClassVar[str] = "rate_dependent_hysteresis"
    place: ClassVar[str] = "displacement"
    experiment: ClassVar[str] = "the same loop at frequencies over two decades"

    widening_um: float = parameter("um")
    onset_um_per_s: float = parameter("um/s", "logarithm", 1e-9, 1e12)
    rate_exponent: float = parameter("1", "linear", 0.01, 0.8)

    def apply(self, signal, sample_period_s, rest=None):
        """See `Effect.apply`."""
        return signal - self._behind(np.gradient(signal, sample_period_s))

    def _behind(self, speed):
        p = self.rate_exponent
        growth = np.expm1(p * np.log1p(np.abs(speed) / self.onset_um_per_s)) / p
        return self.widening_um * np.sign(speed) * growth

    def compensate(self, wanted, sample_period_s):
        """To the first order: ahead by what the wanted signal would stay behind."""
        around = np.concatenate([wanted[-1:], wanted, wanted[:1]])
        return wanted + self._behind(np.gradient(around, sample_period_s)[1:-1])

    @classmethod
    def starts(cls, evidence):
        """The best of a scan."""
        speed = np.gradient(evidence.displacement_um, evidence.sample_period_s)
        largest = float(np.abs(speed).max())
        if largest == 0.0:
            return []
        found = evidence.best(
            [cls(1.0, part * largest, exponent) for exponent in SCANNED_EXPONENTS
             for part in SCANNED_SPEEDS],
            lambda shape: (shape.apply(evidence.displacement_um, evidence.sample_period_s)
                           - evidence.displacement_um)[:, None],
        )
        return [cls(float(gains[0]), shape.onset_um_per_s, shape.rate_exponent)
                for shape, gains in found]
