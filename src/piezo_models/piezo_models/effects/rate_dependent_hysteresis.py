# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis that widens with speed."""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter
from piezo_models.effects.filtering import filtered, filtered_on
from piezo_models.linear.dynamics import simulate_linear, zoh

SCANNED_EXPONENTS = (0.02, 0.5)
SCANNED_ONSETS = np.geomspace(3e-3, 1.0, 5)
"""Onsets that are tried, as fractions of the typical speed."""
SCANNED_TIMES_S = (1e-4, 1e-3, 5e-3)


@dataclass(frozen=True)
class RateDependentHysteresis(Effect):
    """The thresholds of the hysteresis move away from the voltage by a function of its speed.

    They move by widening_v ((1 + speed / onset)^exponent - 1) / exponent, with the speed averaged
    over a time. An exponent of 1 would be a lag of the voltage; one near 0 is a logarithm.
    """

    name: ClassVar[str] = "rate_dependent_hysteresis"
    place: ClassVar[str] = "voltage"
    experiment: ClassVar[str] = "the same loop at frequencies over two decades"
    distortion: ClassVar[frozenset[str] | None] = frozenset({"odd"})

    widening_v: float = parameter("V")
    onset_v_per_s: float = parameter("V/s", "logarithm", LEAST, MOST)
    rate_exponent: float = parameter("1", "linear", 0.01, 0.8)
    averaging_time_s: float = parameter("s", "logarithm", LEAST, MOST)

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, as `Effect.apply` describes."""
        return signal - self._behind(signal, sample_period_s, rest)

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the signal; the past is the state of the filter that averages the speed."""
        speed, past = filtered_on(
            [1.0, 0.0], [self.averaging_time_s, 1.0], signal, sample_period_s, past)
        return signal - self._growth(speed), past

    def _behind(self, signal: FloatArray, sample_period_s: float,
                rest: float | None = None) -> FloatArray:
        return self._growth(
            filtered([1.0, 0.0], [self.averaging_time_s, 1.0], signal, sample_period_s, rest))

    def _growth(self, speed: FloatArray) -> FloatArray:
        """Return how far the thresholds move in V at an averaged speed."""
        p = self.rate_exponent
        growth = np.expm1(p * np.log1p(np.abs(speed) / self.onset_v_per_s)) / p
        return self.widening_v * np.sign(speed) * growth

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the widening: no threshold moves farther than the voltage."""
        return {"widening_v": (-extent.span_v, extent.span_v),
                "averaging_time_s": (1e-2 * extent.sample_period_s, extent.duration_s)}

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the best of a scan in which the hysteresis is approximated by a gain."""
        period_s, voltage_v = evidence.sample_period_s, evidence.voltage_v
        span_v = np.ptp(voltage_v)
        if span_v == 0.0:
            return []
        gain = evidence.travel_um / span_v
        dynamics = zoh(evidence.dynamics.state_space(), period_s)

        def contribution(shape: Self) -> FloatArray:
            return -gain * simulate_linear(dynamics, shape._behind(voltage_v, period_s))[:, None]

        shapes = []
        for time_s in SCANNED_TIMES_S:
            if time_s < period_s and time_s != SCANNED_TIMES_S[-1]:
                continue
            time_s = max(time_s, period_s)
            speed = filtered([1.0, 0.0], [time_s, 1.0], voltage_v, period_s)
            typical = float(np.sqrt(np.mean(speed**2)))
            shapes += [
                cls(1.0, part * typical, exponent, time_s)
                for exponent in SCANNED_EXPONENTS for part in SCANNED_ONSETS
            ]
        found = evidence.best(shapes, contribution, count=2)
        return [cls(float(gains[0]), shape.onset_v_per_s, shape.rate_exponent,
                    shape.averaging_time_s) for shape, gains in found]
