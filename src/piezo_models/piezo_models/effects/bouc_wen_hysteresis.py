# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis of the voltage by a differential equation, whose loops need not close."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Self

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter

STEEPEST = 0.95
"""Largest slope of what is taken from the voltage: the displacement then follows every voltage."""


STEP = 1.0 / 64.0
"""Step of the numerical solution, relative to the relaxation voltage."""

GOES_BACK = "the stage would go back while the voltage goes on"
"""Why a hysteresis that takes more than the voltage adds is impossible."""

BISECTIONS = 40
"""Number of bisections of a step to find where a motion begins."""

KEPT = 16
"""Number of cached solutions."""

SATURATED = 1e-12
"""Distance from saturation at which the numerical solution ends."""


@njit(cache=True, nogil=True)
def _exactly(ahead: float, left: float, unloading: float) -> float:
    """Return what is taken ahead of a motion after its rest, for an exponent of 1."""
    if ahead < 0.0:
        until_zero = -ahead
        if unloading > 0.0:
            until_zero = math.log1p(unloading * until_zero) / unloading
        if left < until_zero:
            grown = -math.expm1(-unloading * left) / unloading if unloading > 0.0 else left
            return ahead * math.exp(-unloading * left) + grown
        ahead, left = 0.0, left - until_zero
    return 1.0 + (ahead - 1.0) * math.exp(-left)


@njit(cache=True, nogil=True)
def _slope(ahead: float, unloading: float, exponent: float) -> float:
    size = min(abs(ahead), 1.0) ** exponent
    return 1.0 + unloading * size if ahead < 0.0 else 1.0 - size


@njit(cache=True, nogil=True)
def _solution(unloading: float, exponent: float) -> FloatArray:
    """Return what is taken after each step of a motion from saturation, and its slopes, (2, N).

    They follow from the Runge-Kutta rule; the slopes are for one step. As the equation contains no
    voltage, every other motion is a part of this one.
    """
    taken = [-1.0]
    while 1.0 - taken[-1] > SATURATED:
        ahead = taken[-1]
        first = _slope(ahead, unloading, exponent)
        second = _slope(ahead + 0.5 * STEP * first, unloading, exponent)
        third = _slope(ahead + 0.5 * STEP * second, unloading, exponent)
        fourth = _slope(ahead + STEP * third, unloading, exponent)
        taken.append(min(ahead + STEP / 6.0 * (first + 2.0 * (second + third) + fourth), 1.0))
    solution = np.empty((2, len(taken)))
    for place in range(len(taken)):
        solution[0, place] = taken[place]
        solution[1, place] = STEP * _slope(taken[place], unloading, exponent)
    return solution


@lru_cache(maxsize=KEPT)
def _kept_solution(unloading: float, exponent: float) -> FloatArray:
    """Return the solution, cached: a stage that moves sample by sample needs it for each of them.

    It is empty for an exponent of 1, which has an exact solution.
    """
    return np.empty((2, 0)) if exponent == 1.0 else _solution(unloading, exponent)


@njit(cache=True, nogil=True)
def _between(solution: FloatArray, place: int, part: float) -> float:
    """Return the solution at a part of a step, by a cubic with its values and slopes."""
    begin, end = solution[0, place], solution[0, place + 1]
    rising = solution[1, place] - (end - begin)
    falling = end - begin - solution[1, place + 1]
    left = 1.0 - part
    return begin * left + end * part + part * left * (rising * left + falling * part)


@njit(cache=True, nogil=True)
def _steps_until(solution: FloatArray, ahead: float) -> float:
    """Return the number of steps, with a fraction, after which the solution reaches a value."""
    last = solution.shape[1] - 1
    if ahead >= solution[0, last]:
        return float(last)
    place = max(int(np.searchsorted(solution[0], ahead, side="right")) - 1, 0)
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        part = 0.5 * (low + high)
        if _between(solution, place, part) < ahead:
            low = part
        else:
            high = part
    return place + 0.5 * (low + high)


@njit(cache=True, nogil=True)
def _after(solution: FloatArray, steps: float) -> float:
    """Return what is taken after some steps from saturation."""
    last = solution.shape[1] - 1
    if steps >= last:
        return solution[0, last]
    place = int(steps)
    return _between(solution, place, steps - place)


@njit(cache=True, nogil=True)
def _taken(voltage_v: FloatArray, last_v: float, taken_v: float, saturation_v: float,
           relaxation_v: float, unloading: float, exponent: float,
           solution: FloatArray) -> FloatArray:
    """Return what is taken from a voltage, (N,), however far samples are apart."""
    taken = np.empty(voltage_v.size)
    last_direction, steps = 0.0, 0.0
    for n in range(voltage_v.size):
        move_v = voltage_v[n] - last_v
        last_v = voltage_v[n]
        if move_v != 0.0:
            direction = math.copysign(1.0, move_v)
            left, ahead = abs(move_v) / relaxation_v, direction * taken_v / saturation_v
            if exponent == 1.0:
                ahead = _exactly(ahead, left, unloading)
            else:
                if direction != last_direction:
                    steps = _steps_until(solution, ahead)
                steps += left / STEP
                # Beyond saturation, nothing is given back.
                ahead = max(ahead, _after(solution, steps))
            last_direction = direction
            taken_v = direction * ahead * saturation_v
        taken[n] = taken_v
    return taken


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
        return self.advance(signal, sample_period_s, None if rest is None else (rest, 0.0))[0]

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the signal behind the effect; the past is the last voltage and its z."""
        signal = np.ascontiguousarray(signal, dtype=float)
        last_v, taken_v = (float(signal[0]), 0.0) if past is None else past
        taken = _taken(signal, last_v, taken_v, self.saturation_v, self.relaxation_v,
                       self.unloading, self.exponent,
                       _kept_solution(self.unloading, self.exponent))
        return signal - taken, (float(signal[-1]), float(taken[-1]))

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
