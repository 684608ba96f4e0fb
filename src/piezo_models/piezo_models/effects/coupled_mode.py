# SPDX-License-Identifier: BSD-3-Clause
"""A mode whose part of the displacement is out of phase with that of the others."""

from dataclasses import dataclass
from typing import ClassVar, Self

import control

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import Evidence, parameter
from piezo_models.effects.filtering import filtered
from piezo_models.effects.vibration_mode import VibrationMode


@dataclass(frozen=True)
class CoupledMode(VibrationMode):
    """A pair of poles with any residue: (p + v s / w) / (1 + 2 d s / w + (s / w)^2).

    Any proper rational dynamics behind a lag is a sum of these and a direct part. Modes of a
    structure have real participations. Modes that are coupled by a damper, an amplifier of higher
    order or another lag also have a part v that follows the velocity. A pair with a damping ratio
    above 1 is two relaxations.
    """

    name: ClassVar[str] = "coupled_mode"
    experiment: ClassVar[str] = VibrationMode.experiment
    indistinguishable_from: ClassVar[tuple[str, ...]] = ("vibration_mode",)

    damping_ratio: float = parameter("1", "logarithm", 1e-5, 100.0)
    participation: float = parameter("1", "linear", -1e3, 1e3)
    velocity_participation: float = parameter("1", "linear", -1e3, 1e3, default=0.0)

    def _parts(self) -> tuple[float, float]:
        return self.participation, self.velocity_participation

    def branch(self) -> control.StateSpace:
        """Return the continuous system of the mode's contribution to the displacement."""
        return self._system(*self._parts())

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the mode if it is the only one."""
        w = self.frequency_rad_per_s
        branch = filtered([self.velocity_participation * w, self.participation * w * w],
                          self._mode()[1], signal, sample_period_s, rest)
        return (1.0 - self.participation) * signal + branch

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Return none: `identify` finds these modes together with the dynamics."""
        return []


