# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis of Bouc and Wen beside a curve of the voltage."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects.bouc_wen_hysteresis import GOES_BACK, STEEPEST, BoucWenHysteresis
from piezo_models.effects.effect import Extent, parameter

MOST_CURVED = 0.4
"""Largest curvature times the voltage range: the slope of the curve stays above a fifth."""

CYCLE = 200
"""Number of steps from one end of the voltage range to the other in which its slopes are seen."""


@dataclass(frozen=True)
class CurvedBoucWenHysteresis(BoucWenHysteresis):
    """The voltage that acts is u + c u^2 - z, where z follows u as Bouc and Wen describe it.

    A curve behind the hysteresis makes z larger where it is steeper. Here, z is equally large at
    all voltages, as in the sum of a polynomial of the voltage and a hysteresis.
    """

    name: ClassVar[str] = "curved_bouc_wen_hysteresis"
    distortion: ClassVar[frozenset[str] | None] = frozenset({"even", "odd"})
    confounded_with: ClassVar[tuple[str, ...]] = ("bouc_wen_hysteresis", "hysteresis")

    curvature_per_v: float = parameter("1/V", "linear", -10.0, 10.0, default=0.0)

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the signal behind the effect, as `BoucWenHysteresis.advance` describes."""
        behind, memory = super().advance(signal, sample_period_s, past)
        return behind + self.curvature_per_v * np.square(signal), memory

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the curvature, as well, by the span of the recordings."""
        most_per_v = MOST_CURVED / extent.span_v
        return {**super().bounds(extent), "curvature_per_v": (-most_per_v, most_per_v)}

    def impossible(self, extent: Extent) -> str | None:
        """Reject a displacement that decreases while the voltage rises."""
        cycle_v = np.interp(np.arange(3 * CYCLE + 1) / CYCLE, np.arange(4), [
            extent.lowest_v, extent.highest_v, extent.lowest_v, extent.highest_v])
        slopes = np.diff(self.apply(cycle_v, extent.sample_period_s)) / np.diff(cycle_v)
        return GOES_BACK if slopes.min() < 1.0 - STEEPEST else None
