# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis of Bouc and Wen whose width depends on the voltage, beside a curve of the voltage."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects.bouc_wen_hysteresis import (
    GOES_BACK,
    STEEPEST,
    BoucWenHysteresis,
    taken_parts,
)
from piezo_models.effects.effect import Extent, parameter

MOST_CURVED = 0.4
"""Largest change of the slope of the curve by each of its coefficients, from the middle to an end;
for the curvature with 0 V at one end, twice as much."""

MOST_TILTED = 0.5
"""Largest difference of the decay at an end of the voltage range from that in the middle."""

CYCLE = 200
"""Number of steps from one end of the voltage range to the other in which its slopes are seen."""


@dataclass(frozen=True)
class CurvedBoucWenHysteresis(BoucWenHysteresis):
    """The voltage that acts is v + c v^2 + d v^3 - z, where z grows differently at each voltage.

    With v = u - m, the part x = z / S grows by L dx/du = g - (1 + t) x^n, and by g + (r - t) |x|^n
    or not at all while what is left of the opposite direction decreases. Here, g is 1 + a v + b v^2
    or 0, and t is e v if the voltage rises and -e v if it falls. With r = n = 1 and e = 0, this is
    the equation of Coleman and Hodgdon (1986) with polynomials. With r = 0, n = 1 and e = 0, it
    approximates that of Jiles and Atherton (1986), whose loops become narrow where the domains
    saturate. With e, the two sides of a loop differ.

    A curve behind the hysteresis makes z larger where it is steeper. The one beside it does not, as
    in the sum of a polynomial of the voltage and a hysteresis.
    """

    name: ClassVar[str] = "curved_bouc_wen_hysteresis"
    distortion: ClassVar[frozenset[str] | None] = frozenset({"even", "odd"})
    confounded_with: ClassVar[tuple[str, ...]] = ("bouc_wen_hysteresis", "hysteresis")

    curvature_per_v: float = parameter("1/V", "linear", -10.0, 10.0, default=0.0)
    cubic_per_v2: float = parameter("1/V^2", "linear", -10.0, 10.0, default=0.0)
    growth_slope_per_v: float = parameter("1/V", "linear", -10.0, 10.0, default=0.0)
    growth_curvature_per_v2: float = parameter("1/V^2", "linear", -10.0, 10.0, default=0.0)
    decay_slope_per_v: float = parameter("1/V", "linear", -10.0, 10.0, default=0.0)
    middle_v: float = parameter("V", "fixed", default=0.0)

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the signal behind the effect, as `BoucWenHysteresis.advance` describes."""
        behind, memory = super().advance(signal, sample_period_s, past)
        off_v = signal - self.middle_v
        curve = self.curvature_per_v + self.cubic_per_v2 * off_v
        return behind + curve * np.square(off_v), memory

    def _parts(self, voltage_v: FloatArray, last_v: float,
               motion: FloatArray) -> tuple[FloatArray, FloatArray]:
        return taken_parts(
            voltage_v - self.middle_v, last_v - self.middle_v, motion, self.relaxation_v,
            self.unloading, self.exponent, self.growth_slope_per_v, self.growth_curvature_per_v2,
            self.decay_slope_per_v)

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the polynomials, as well, by what they change at the ends of the recordings.

        Each coefficient of the growth changes it by one at most.
        """
        half_v = 0.5 * extent.span_v
        most = {"curvature_per_v": MOST_CURVED / extent.span_v,
                "cubic_per_v2": MOST_CURVED / (3.0 * half_v**2),
                "growth_slope_per_v": 1.0 / half_v, "growth_curvature_per_v2": half_v**-2,
                "decay_slope_per_v": MOST_TILTED / half_v}
        return {**super().bounds(extent), **{name: (-each, each) for name, each in most.items()}}

    def impossible(self, extent: Extent) -> str | None:
        """Reject a displacement that decreases while the voltage rises."""
        cycle_v = np.interp(np.arange(3 * CYCLE + 1) / CYCLE, np.arange(4), [
            extent.lowest_v, extent.highest_v, extent.lowest_v, extent.highest_v])
        slopes = np.diff(self.apply(cycle_v, extent.sample_period_s)) / np.diff(cycle_v)
        return GOES_BACK if slopes.min() < 1.0 - STEEPEST else None
