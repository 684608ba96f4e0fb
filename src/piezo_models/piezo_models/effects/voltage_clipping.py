# SPDX-License-Identifier: BSD-3-Clause
"""Amplifier that does not reach the commanded voltages."""

import math
from dataclasses import dataclass
from itertools import product
from typing import ClassVar, Self

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import Effect, Evidence, Extent, parameter
from piezo_models.effects.slew_limit import SlewLimit

SCANNED_PARTS = (-0.03, -0.01, 0.0, 0.003, 0.01, 0.03, 0.1, 0.2)
"""Distances of the limit from the end of the voltages that are tried, as fractions of their span; a
soft limit acts early."""
SCANNED_KNEES = (0.003, 0.01, 0.03)
KNEES_OF_REACH = 2.0
WIDEST_KNEE_V = 10.0
"""Largest width of the knee: a wider curvature belongs to the stage, not to an amplifier limit."""

TRIED, LIKELY_GAIN = 4, 4.0

NEWTON_STEPS = 40
INVERSION_TOLERANCE = 1e-9

FARTHEST_KNEES = 9.0
"""Distance from a limit, in knees, at which it removes less than the rounding of a voltage."""


@njit(cache=True, nogil=True)
def _beyond(distance_v: FloatArray, knee_v: float) -> tuple[FloatArray, FloatArray]:
    """Return what a limit removes from a voltage at a distance beyond it, and the slope."""
    removed, slopes = np.zeros(distance_v.size), np.zeros(distance_v.size)
    for n in range(distance_v.size):
        x = distance_v[n] / knee_v
        if x > FARTHEST_KNEES:
            removed[n], slopes[n] = distance_v[n], 1.0
        elif x > -FARTHEST_KNEES:
            slopes[n] = 0.5 * math.erfc(-x / math.sqrt(2.0))
            removed[n] = knee_v * (
                x * slopes[n] + math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi))
    return removed, slopes


@dataclass(frozen=True)
class VoltageClipping(Effect):
    """Voltages beyond two limits are replaced by the limits.

    The limits may be soft, as if spread by a normal distribution of standard deviation `knee_v`.
    """

    name: ClassVar[str] = "voltage_clipping"
    place: ClassVar[str] = "voltage"
    remembers: ClassVar[bool] = False
    experiment: ClassVar[str] = "hysteresis: harmonics over the whole range"
    distortion: ClassVar[frozenset[str] | None] = frozenset({"even", "odd"})

    lowest_v: float = parameter("V")
    highest_v: float = parameter("V")
    knee_v: float = parameter("V", "linear", 0.0, WIDEST_KNEE_V, default=0.0)

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, as `Effect.apply` describes."""
        highest_v = max(self.lowest_v, self.highest_v)
        if self.knee_v == 0.0:
            return np.clip(signal, self.lowest_v, highest_v)
        over, _ = _beyond(signal - highest_v, self.knee_v)
        under, _ = _beyond(self.lowest_v - signal, self.knee_v)
        return signal - over + under

    def compensate(self, wanted: FloatArray, sample_period_s: float) -> FloatArray:
        """Return the voltage that gives the wanted one through the knees of the limits."""
        refusal = (
            f"the voltage would go from {wanted.min():.6g} to {wanted.max():.6g} V, the amplifier "
            f"gives {self.lowest_v:.6g} to {self.highest_v:.6g} V: reduce the motion"
        )
        if wanted.min() < self.lowest_v or wanted.max() > self.highest_v:
            raise ValueError(refusal)
        if self.knee_v == 0.0:
            return wanted
        voltage_v = wanted.copy()
        for _ in range(NEWTON_STEPS):
            over, over_slope = _beyond(voltage_v - self.highest_v, self.knee_v)
            under, under_slope = _beyond(self.lowest_v - voltage_v, self.knee_v)
            missing = wanted - (voltage_v - over + under)
            if np.abs(missing).max() < INVERSION_TOLERANCE * self.knee_v:
                return voltage_v
            voltage_v = voltage_v + missing / np.maximum(1.0 - over_slope - under_slope, 1e-3)
        raise ValueError(refusal)

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the limits to the played voltages and near them, the knee to half their span."""
        low, high, span_v = extent.lowest_v, extent.highest_v, extent.span_v
        return {"lowest_v": (low - span_v, high), "highest_v": (low, high + span_v),
                "knee_v": (0.0, 0.5 * span_v)}

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the best of a scan, by what the limits remove from the voltage."""
        low, high = evidence.voltage_v.min(), evidence.voltage_v.max()
        span = high - low
        shapes = []
        for knee, part in product(SCANNED_KNEES, SCANNED_PARTS):
            if part > -KNEES_OF_REACH * knee:
                # The other limit is out of reach.
                out_of_reach = 2.0 * KNEES_OF_REACH * knee * span
                knee_v = min(knee * span, WIDEST_KNEE_V)
                shapes += [cls(low - out_of_reach, high - part * span, knee_v),
                           cls(low + part * span, high + out_of_reach, knee_v)]
        found = evidence.best(
            shapes,
            lambda shape: (shape.apply(evidence.voltage_v, evidence.sample_period_s)
                           - evidence.voltage_v)[:, None],
            len(shapes),
        )
        # The voltage removed by a limit must be missing with about the gain of the stage.
        gain = evidence.travel_um / span
        return [shape for shape, gains in found
                if gain / LIKELY_GAIN < gains[0] < gain * LIKELY_GAIN][:TRIED]

    lacks_excitation = SlewLimit.lacks_excitation
