# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis of the voltage by a differential equation, whose loops need not close."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter

STEEPEST = 0.95
"""Largest slope of what is taken from the voltage: the displacement then follows every voltage."""

SHORT_STEP, STEP, LONG_STEP = 1.0 / 64.0, 1.0 / 16.0, 1.0 / 4.0
"""Steps of the numerical solution, relative to the relaxation voltage: where the branch changes,
elsewhere, and after a motion of the length `SETTLED`."""

SETTLED = 8.0
"""Length of a motion, in relaxation voltages, after which its steps are long."""

GOES_BACK = "the stage would go back while the voltage goes on"
"""Why a hysteresis that takes more than the voltage adds is impossible."""


@njit(cache=True, nogil=True)
def _slope(ahead: float, at_v: float, unloading: float, exponent: float, slope_per_v: float,
           curvature_per_v2: float, tilt_per_v: float) -> float:
    """Return the slope for a voltage from the middle, in relaxation voltages."""
    tilt = tilt_per_v * at_v
    size = abs(ahead) ** exponent
    # A negative growth would run away.
    growth = max(1.0 + at_v * (slope_per_v + at_v * curvature_per_v2), 0.0)
    if ahead < 0.0:
        return max(growth + (unloading - tilt) * size, 0.0)
    return growth - (1.0 + tilt) * size


@njit(cache=True, nogil=True)
def taken_parts(voltage_v: FloatArray, last_v: float, motion: FloatArray, relaxation_v: float,
                unloading: float, exponent: float, slope_per_v: float, curvature_per_v2: float,
                decay_slope_per_v: float) -> tuple[FloatArray, FloatArray]:
    """Return what is taken from a voltage, from the middle, relative to saturation, (N,).

    It is followed by the motion to continue from, like the given one. Each motion is solved in
    steps of the voltage by the Runge-Kutta rule. Samples within a step follow from the cubic with
    its values and slopes.
    """
    part, direction, begin, slope, end, end_slope, end_v, step, length = motion
    shape = (unloading, exponent, slope_per_v, curvature_per_v2)
    taken = np.empty(voltage_v.size)
    for n in range(voltage_v.size):
        if voltage_v[n] != last_v:
            if math.copysign(1.0, voltage_v[n] - last_v) != direction:
                direction = math.copysign(1.0, voltage_v[n] - last_v)
                end, end_v, length = direction * part, last_v, 0.0
                end_slope = _slope(end, end_v, *shape, direction * decay_slope_per_v)
            tilt_per_v = direction * decay_slope_per_v
            while direction * (voltage_v[n] - end_v) > 0.0:
                begin, slope = end, end_slope
                step = STEP if length < SETTLED else LONG_STEP
                if begin < 0.0 and begin + 2.0 * step * slope > 0.0:
                    step = SHORT_STEP
                step_v, length = direction * step * relaxation_v, length + step
                halfway_v, end_v = end_v + 0.5 * step_v, end_v + step_v
                second = _slope(begin + 0.5 * step * slope, halfway_v, *shape, tilt_per_v)
                third = _slope(begin + 0.5 * step * second, halfway_v, *shape, tilt_per_v)
                fourth = _slope(begin + step * third, end_v, *shape, tilt_per_v)
                end = begin + step * (slope + 2.0 * (second + third) + fourth) / 6.0
                end_slope = _slope(end, end_v, *shape, tilt_per_v)
            last_v = voltage_v[n]
            left = direction * (end_v - last_v) / (step * relaxation_v)
            rising, falling = step * slope - (end - begin), end - begin - step * end_slope
            part = direction * (begin * left + end * (1.0 - left) + left * (1.0 - left) * (
                rising * left + falling * (1.0 - left)))
        taken[n] = part
    return taken, np.array(
        [part, direction, begin, slope, end, end_slope, end_v, step, length])


STILL = np.zeros(9)
"""Motion of `taken_parts` of a stage from which nothing is taken."""


@dataclass(frozen=True)
class BoucWenHysteresis(Effect):
    """The voltage that acts is u - z, where z follows u as Bouc and Wen describe it.

    In the direction of the motion, the part x = z / S grows by L dx/du = 1 - x^n, and by
    1 + r |x|^n, with the factor r of unloading, while what is left of the opposite direction
    decreases. This is ``z' = a u' - b |u'| |z|^(n-1) z - c u' |z|^n`` (Wen 1976) with
    S^n = a / (b + c), L = S / a and r = (b - c) / (b + c). With r = n = 1, it is the model of Dahl,
    and that of Jiles and Atherton about a line. Minor loops drift, unlike those of a Preisach
    hysteresis.
    """

    name: ClassVar[str] = "bouc_wen_hysteresis"
    place: ClassVar[str] = "voltage"
    experiment: ClassVar[str] = "hysteresis: slow triangles of rising amplitude"
    distortion: ClassVar[frozenset[str] | None] = frozenset({"odd"})
    confounded_with: ClassVar[tuple[str, ...]] = ("hysteresis",)

    saturation_v: float = parameter("V", "logarithm", LEAST, MOST)
    relaxation_v: float = parameter("V", "logarithm", LEAST, MOST)
    unloading: float = parameter("1", "linear", 0.0, 5.0, default=1.0)
    exponent: float = parameter("1", "logarithm", 0.5, 5.0, default=1.0)

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, as `Effect.apply` describes."""
        past = None if rest is None else np.append(rest, STILL)
        return self.advance(signal, sample_period_s, past)[0]

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the signal behind the effect; the past is the last voltage and its motion."""
        signal = np.ascontiguousarray(signal, dtype=float)
        last_v, *motion = np.append(signal[0], STILL) if past is None else past
        parts, moving = self._parts(signal, last_v, np.array(motion))
        return signal - self.saturation_v * parts, np.append(signal[-1], moving)

    def _parts(self, voltage_v: FloatArray, last_v: float,
               motion: FloatArray) -> tuple[FloatArray, FloatArray]:
        return taken_parts(voltage_v, last_v, motion, self.relaxation_v, self.unloading,
                           self.exponent, 0.0, 0.0, 0.0)

    def memory_after(self, voltage_v: ArrayLike) -> Any:
        """Return the memory after voltages; as the equation has no time, their period is free."""
        return self.advance(np.asarray(voltage_v, dtype=float), 1.0)[1]

    @property
    def gain_range(self) -> tuple[float, float]:
        """Return the smallest and largest slope of what is passed on over the voltage."""
        return 1.0 - (1.0 + self.unloading) * self.saturation_v / self.relaxation_v, 1.0

    @property
    def goes_back(self) -> bool:
        """Return whether a displacement would decrease, or hardly move, as the voltage rises."""
        return self.gain_range[0] < 1.0 - STEEPEST

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the voltages by the span of the recordings."""
        return {"saturation_v": (1e-5 * extent.span_v, extent.span_v),
                "relaxation_v": (1e-3 * extent.span_v, 10.0 * extent.span_v)}

    def impossible(self, extent: Extent) -> str | None:
        """Reject a displacement that decreases while the voltage rises."""
        return GOES_BACK if self.goes_back else None

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Return none: `identify` compares it with the loops of the model."""
        return []
