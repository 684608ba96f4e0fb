# SPDX-License-Identifier: BSD-3-Clause
"""Drift with ambient temperature, independent of the voltage."""

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.polynomial.chebyshev import chebval
from numpy.polynomial.legendre import legvander

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Evidence, Extent, parameter
from piezo_models.effects.effect_of_time import EffectOfTime

WAVES = 8
"""Half periods of the fastest wave in the recording."""

VISIBLE = 0.005
"""Fraction of a steady drift that unknown creep must leave unexplained, for the drift to show."""

FARTHEST, SLOWEST = 2.0, 3.0
"""Bounds of a part in measured ranges (two parts may partly cancel each other or the motion), and
of the time constant in durations of the recording, which shows no end of a slower approach."""


@dataclass(frozen=True)
class ThermalDrift(EffectOfTime):
    """A constant rate, an approach to a new temperature, and slow waves about both.

    The waves cannot be extrapolated: beyond the recording they keep their final value.
    """

    name: ClassVar[str] = "thermal_drift"
    recurs: ClassVar[bool] = True
    experiment: ClassVar[str] = "rest for minutes, and the same waveform repeated at later times"
    distortion: ClassVar[frozenset[str] | None] = frozenset()
    confounded_with: ClassVar[tuple[str, ...]] = ("creep",)

    rate_um_per_s: float = parameter("um/s")
    approach_um: float = parameter("um")
    time_constant_s: float = parameter("s", "logarithm", LEAST, MOST)
    waves_um: tuple[float, ...] = parameter("um", default=())
    duration_s: float = parameter("s", "fixed", LEAST, MOST, default=1.0)

    def behind(self, signal: FloatArray, sample_period_s: float, first: int) -> FloatArray:
        """Return a part of the signal behind the effect, as `EffectOfTime.behind` describes."""
        time_s = np.arange(first, first + signal.size, dtype=np.float64) * sample_period_s
        return signal + self._drift_um(time_s)

    def _drift_um(self, time_s: FloatArray) -> FloatArray:
        """Return the sum of all parts in um; the waves are a Chebyshev series of one cosine."""
        drift_um = self.rate_um_per_s * time_s - self.approach_um * np.expm1(
            -time_s / self.time_constant_s)
        if self.waves_um:
            phase = np.pi * np.minimum(time_s / self.duration_s, 1.0)
            drift_um += chebval(np.cos(phase), [-sum(self.waves_um), 0.0, *self.waves_um])
        return drift_um

    def _drifts(self, time_s: FloatArray) -> FloatArray:
        phase = np.pi * np.minimum(time_s / self.duration_s, 1.0)
        return np.column_stack([
            time_s, -np.expm1(-time_s / self.time_constant_s),
            *(np.cos((wave + 2) * phase) - 1.0 for wave in range(len(self.waves_um))),
        ])

    def recurrence(self, time_s: FloatArray, duration_s: float) -> FloatArray:
        """Return polynomials, as `Effect.recurrence` describes."""
        polynomials: FloatArray = legvander(2.0 * time_s / duration_s - 1.0, WAVES).astype(float)
        return polynomials[:, 1:]

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound each part to a drift of `FARTHEST` times the measured range."""
        farthest_um = FARTHEST * extent.travel_um
        return {
            "rate_um_per_s": (-farthest_um / extent.duration_s, farthest_um / extent.duration_s),
            "approach_um": (-farthest_um, farthest_um), "waves_um": (-farthest_um, farthest_um),
            "time_constant_s": (extent.sample_period_s, SLOWEST * extent.duration_s),
        }

    def impossible(self, extent: Extent) -> str | None:
        """Reject a drift that exceeds the motion that the sensor measured."""
        time_s = np.linspace(0.0, extent.duration_s, 200)
        drift_um = self._drift_um(time_s)
        if np.ptp(drift_um) > FARTHEST * extent.travel_um:
            return (f"it would drift by {np.ptp(drift_um):.3g} um while the sensor saw no more "
                    f"than {extent.travel_um:.3g} um")
        return None

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the best of a few time constants."""
        shapes = [
            cls(0.0, 0.0, part * evidence.duration_s, (0.0,) * waves, evidence.duration_s)
            for part in (0.1, 0.3, 1.0) for waves in (0, WAVES - 1)
        ]
        found = evidence.best(shapes, lambda shape: shape._drifts(evidence.time_s), count=4)
        return [
            replace(shape, rate_um_per_s=gains[0], approach_um=gains[1], waves_um=tuple(gains[2:]))
            for shape, gains in found
        ]

    @classmethod
    def lacks_excitation(cls, evidence: Evidence) -> str | None:
        """Reject a recording that is too short to distinguish drift from earlier creep."""
        if evidence.visible(evidence.time_s[:, None]) < VISIBLE:
            return "in so short a time, a drift looks like creep that had begun before"
        return None
