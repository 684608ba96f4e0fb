# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis of generalised viscous plays behind a quadratic law.

A play of threshold r keeps its output w between two envelopes of the voltage v,

    gamma(v) - r h(v) <= w <= gamma(v) + r h(v),
    gamma(v) = s tanh((v - c) / s),   h(v) = 1 + a (v - c),

and returns there with a time constant, so that loops widen with the rate. The thresholds are the
quantiles of a Weibull distribution. With the polarisation p = p0 gamma(v) + p1 mean(w) the output
is p + q p^2: strain goes with the square of the polarisation about its bias.

Under slow voltages, a larger excursion wipes out the memory of the plays. Loops between the same
voltages are congruent in p, but not in the output: their heights differ by the factor
(1 + q (p_low + p_high)) of either loop. No Preisach density has such loops.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_sim.plant.plant_effect import (
    NOT_NEGATIVE,
    POSITIVE,
    Bounded,
    Surroundings,
    parameter,
    require,
)


@njit(cache=True)
def _play(samples: FloatArray, plays_v: FloatArray, thresholds_v: FloatArray, kept: float,
          centre_v: float, scale_v: float, growth_per_v: float, instant: float, delayed: float,
          curvature_per_um: float, offset_um: float) -> None:
    for n in range(samples.size):
        deviation_v = samples[n] - centre_v
        middle_v = scale_v * math.tanh(deviation_v / scale_v)
        widening = 1.0 + growth_per_v * deviation_v
        total_v = 0.0
        for i in range(plays_v.size):
            half_v = thresholds_v[i] * widening
            wanted_v = min(max(plays_v[i], middle_v - half_v), middle_v + half_v)
            plays_v[i] = wanted_v + kept * (plays_v[i] - wanted_v)
            total_v += plays_v[i]
        polarisation_um = instant * middle_v + delayed * total_v
        samples[n] = offset_um + polarisation_um * (1.0 + curvature_per_um * polarisation_um)


@dataclass(frozen=True)
class GeneralisedPlays(Bounded):
    """Generalised Prandtl-Ishlinskii hysteresis, rate-dependent, with a quadratic output."""

    name: ClassVar[str] = "generalised_plays"

    lowest_voltage_v: float = parameter("V")
    plays: int = parameter("1")
    threshold_scale_v: float = parameter("V", POSITIVE)
    threshold_shape: float = parameter("1", POSITIVE)
    threshold_growth_per_v: float = parameter("1/V")
    envelope_centre_v: float = parameter("V")
    envelope_scale_v: float = parameter("V", POSITIVE)
    instant_gain_um_per_v: float = parameter("um/V", NOT_NEGATIVE)
    play_gain_um_per_v: float = parameter("um/V", NOT_NEGATIVE)
    viscous_time_s: float = parameter("s", POSITIVE)
    curvature_per_um: float = parameter("1/um")
    offset_um: float = parameter("um")

    def __post_init__(self) -> None:
        super().__post_init__()
        require(1 <= self.plays <= 256, self, "plays must be an integer from 1 to 256.")
        lowest_v = self.lowest_voltage_v - self.envelope_centre_v
        require(
            abs(self.threshold_growth_per_v * lowest_v) < 1.0,
            self,
            "threshold_growth_per_v must leave every threshold positive at the lowest voltage.",
        )
        furthest_um = self.envelope_scale_v * (
            self.instant_gain_um_per_v + self.play_gain_um_per_v
        ) * math.tanh(lowest_v / self.envelope_scale_v)
        require(
            abs(2.0 * self.curvature_per_um * furthest_um) < 1.0,
            self,
            "curvature_per_um must leave the gain positive at the lowest voltage.",
        )

    def thresholds_v(self) -> FloatArray:
        """Return the thresholds of the plays in V, shape (plays,), ascending."""
        quantiles = (np.arange(self.plays) + 0.5) / self.plays
        return self.threshold_scale_v * (-np.log1p(-quantiles)) ** (1.0 / self.threshold_shape)

    def start(self, surroundings: Surroundings) -> "PlaysRunner":
        """Start at the lowest voltage, reached from far above."""
        return PlaysRunner(self, surroundings.sample_period_s)


class PlaysRunner:
    """Hysteresis with the present output w of each play (V) as its state."""

    def __init__(self, effect: GeneralisedPlays, sample_period_s: float) -> None:
        self._thresholds_v = effect.thresholds_v()
        self._kept = math.exp(-sample_period_s / effect.viscous_time_s)
        self._shape = (
            effect.envelope_centre_v,
            effect.envelope_scale_v,
            effect.threshold_growth_per_v,
            effect.instant_gain_um_per_v,
            effect.play_gain_um_per_v / effect.plays,
            effect.curvature_per_um,
            effect.offset_um,
        )
        # Far above their envelopes, so that the first voltage puts all plays on the falling ones.
        self.plays_v = np.full(effect.plays, np.finfo(float).max)
        self.rest(effect.lowest_voltage_v)

    def rest(self, level: float) -> float:
        """Go slowly from the present state to the voltage `level`; return the output."""
        samples = np.array([level])
        _play(samples, self.plays_v, self._thresholds_v, 0.0, *self._shape)
        return float(samples[0])

    def apply(self, samples: FloatArray) -> None:
        """Replace voltages by hysteresis outputs in um."""
        _play(samples, self.plays_v, self._thresholds_v, self._kept, *self._shape)
