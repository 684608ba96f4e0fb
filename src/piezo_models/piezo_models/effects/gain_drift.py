# SPDX-License-Identifier: BSD-3-Clause
"""Gain that changes with time, as a ceramic ages or an amplifier warms up."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Evidence, Extent, parameter
from piezo_models.effects.effect_of_time import EffectOfTime

SCANNED_TIMES = (0.1, 0.3, 1.0, 10.0)
"""Time constants that are tried, in durations of the recording; the longest is nearly a line."""

FARTHEST = 10.0
"""Largest distance of the fixed point from the middle of the motion, in travels. Beyond it, a
change of gain is equivalent to a drift."""

LEAST_SHARE = 0.05
"""The gain must remove at least this fraction of the residual that a drift leaves, or it is not
fitted."""


@dataclass(frozen=True)
class GainDrift(EffectOfTime):
    """The motion about a fixed point grows or shrinks exponentially to a final gain.

    It is multiplied by 1 + change (1 - exp(-t / time constant)), from the first sample on.
    """

    name: ClassVar[str] = "gain_drift"
    experiment: ClassVar[str] = "the same waveform repeated for minutes, from a cold start"

    change: float = parameter("1", "linear", -10.0, 10.0)
    time_constant_s: float = parameter("s", "logarithm", LEAST, MOST)
    fixed_point_um: float = parameter("um")

    def behind(self, signal: FloatArray, sample_period_s: float, first: int) -> FloatArray:
        """Return a part of the signal behind the effect, as `EffectOfTime.behind` describes."""
        time_s = np.arange(first, first + signal.size, dtype=np.float64) * sample_period_s
        grown = self.change * self._approach(time_s)
        return signal + grown * (signal - self.fixed_point_um)

    def _approach(self, time_s: FloatArray) -> FloatArray:
        return -np.expm1(-time_s / self.time_constant_s)

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the time constant by the recording."""
        return {"time_constant_s": (extent.sample_period_s,
                                    SCANNED_TIMES[-1] * extent.duration_s)}

    def impossible(self, extent: Extent) -> str | None:
        """Reject a gain that changes its sign within the recording."""
        if 1.0 + self.change * float(self._approach(np.array(extent.duration_s))) <= 0.0:
            return "the gain would change its sign"
        return None

    @classmethod
    def lacks_excitation(cls, evidence: Evidence) -> str | None:
        """Require motion."""
        return None if evidence.travel_um > 0.0 else "the displacement does not move"

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the best of a few time constants, if a drift leaves clearly more."""
        found: list[tuple[float, Self]] = []
        middle_um = float(np.mean(evidence.displacement_um))
        about_um = evidence.displacement_um - middle_um
        for part in SCANNED_TIMES:
            time_s = part * evidence.duration_s
            approach = cls(0.0, time_s, 0.0)._approach(evidence.time_s)
            _, of_drift = evidence.reduction(approach[:, None])
            (change, drift_um), share = evidence.reduction(
                np.column_stack([approach * about_um, approach]))
            farthest_um = abs(change) * FARTHEST * evidence.travel_um
            if share - of_drift < LEAST_SHARE * (1.0 - of_drift) or abs(drift_um) > farthest_um:
                continue
            found.append((share, cls(float(np.clip(change, -10.0, 10.0)), time_s,
                                     middle_um - float(drift_um / change))))
        found.sort(key=lambda entry: -entry[0])
        return [start for _, start in found[:2]]
