# SPDX-License-Identifier: BSD-3-Clause
"""A delayed part of the voltage, in front of the hysteresis."""

from dataclasses import dataclass
from typing import ClassVar, Self

import control

from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.effect import Evidence, parameter
from piezo_models.effects.filtering import slowed
from piezo_models.effects.lag import Lag

MOST = 0.9
"""Largest delayed share; for a larger one, a lag of the whole voltage is the simpler form."""
LEAST = 1e-3
"""Smallest share with which a fit starts."""
CLEARLY_LESS = 0.95
"""Largest residual of a start, relative to that of a lag of the whole voltage: for motion that is
slow compared with the time constant, both are the same delay."""


@dataclass(frozen=True)
class VoltageRelaxation(Lag):
    """A share of the voltage at the actuator is delayed; the rest acts at once.

    The transfer function is 1 - share + share / (1 + T s), as for leads with two paths to the
    actuator or a dielectric that charges in two ways. With a share of 1 it is `amplifier_lag`.
    """

    name: ClassVar[str] = "voltage_relaxation"
    place: ClassVar[str] = "voltage"
    experiment: ClassVar[str] = "steps, and loops whose period is near the time constant"
    confounded_with: ClassVar[tuple[str, ...]] = ("amplifier_lag", "creep")

    share: float = parameter("1", "linear", 0.0, MOST, default=0.5)

    @property
    def slow_delay_s(self) -> float:
        """Return the delay of slow signals in s."""
        return self.share * self.time_constant_s

    def lag(self) -> control.StateSpace:
        """Return the relaxation as a continuous system, as `Effect.lag` describes."""
        return slowed([1.0 - self.share, 1.0], [1.0, 1.0], self.time_constant_s)

    def _numerator(self) -> list[float]:
        return [(1.0 - self.share) * self.time_constant_s, 1.0]

    def _denominator(self) -> list[float]:
        return [self.time_constant_s, 1.0]

    @classmethod
    def tried(cls, time_constant_s: float) -> Self:
        """Return the relaxation with a time constant of the scan."""
        return cls(time_constant_s, MOST)

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the best of a scan, whose gain is the share, unless a plain lag fits too."""
        def residual(effect: Lag) -> float:
            behind_um = effect.apply(evidence.displacement_um, evidence.sample_period_s)
            return 1.0 - evidence.reduction((behind_um - evidence.displacement_um)[:, None])[1]

        whole = min(map(residual, AmplifierLag.starts(evidence)), default=1.0)
        return [cls(shape.time_constant_s, max(MOST * gain, LEAST))
                for shape, gain in cls.scanned(evidence)
                if gain < 1.0 and residual(shape) < CLEARLY_LESS * whole]
