# SPDX-License-Identifier: BSD-3-Clause
"""Delay of the whole displacement, the dead time of the stage."""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import control
import numpy as np
from scipy.interpolate import CubicSpline

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.effects.effect import MOST, Effect, Evidence, Extent, parameter
from piezo_models.effects.filtering import slowed

CUBIC = 3

PADE_ORDER = 3
"""The Pade approximation is exact to 0.1 degree up to a phase of 90 degrees."""

LONGEST = 0.1
"""Longest delay as a fraction of the recording."""


@dataclass(frozen=True)
class Delay(Effect):
    """The whole displacement is delayed by the same time."""

    name: ClassVar[str] = "delay"
    place: ClassVar[str] = "displacement"
    experiment: ClassVar[str] = "dynamics: steps, or tones up to the highest frequency of interest"
    distortion: ClassVar[frozenset[str] | None] = frozenset()
    confounded_with: ClassVar[tuple[str, ...]] = ("sensor_lag",)

    delay_s: float = parameter("s", "linear", 0.0, MOST)

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, as `Effect.apply` describes."""
        rest = signal[0] if rest is None else rest
        return self.advance(signal, sample_period_s, np.full(
            self._remembered(sample_period_s, signal.size), rest))[0]

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the signal; the past is the samples that have not arrived in full.

        Lagrange's cubic interpolates through the four samples around the instant. For a delay
        shorter than a sample it uses the last four, as the next one is not known yet.
        """
        if past is None:
            past = np.full(self._remembered(sample_period_s), signal[0])
        known = np.concatenate([past, signal])
        late = self.delay_s / sample_period_s
        latest = min(max(int(late) - 1, 0), past.size - CUBIC)
        behind = np.zeros(signal.size)
        for weight, node in zip(_lagrange(late - int(late) + min(int(late), 1)), range(CUBIC + 1),
                                strict=True):
            first = past.size - latest - node
            behind += weight * known[first : first + signal.size]
        return behind, known[known.size - past.size :]

    def _remembered(self, sample_period_s: float, most: float = np.inf) -> int:
        """Return the number of past samples to keep, limited to `most` whole samples of delay."""
        return int(min(max(int(self.delay_s / sample_period_s) - 1, 0), most)) + CUBIC

    def compensate(self, wanted: FloatArray, sample_period_s: float) -> FloatArray:
        """Return the period advanced by the delay."""
        phase = np.arange(wanted.size + 1)
        spline = CubicSpline(phase, np.append(wanted, wanted[0]), bc_type="periodic")
        return spline((phase[:-1] + self.delay_s / sample_period_s) % wanted.size)

    def lag(self) -> control.StateSpace | None:
        """Return the lag as a continuous system, as `Effect.lag` describes."""
        unit = control.pade(1.0, PADE_ORDER)
        return slowed(unit[0], unit[1], self.delay_s) if self.delay_s > 0.0 else None

    def response(self, s: ComplexArray) -> ComplexArray:
        """Return the factor of the effect in the frequency response."""
        return np.exp(-s * self.delay_s)

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the parameters by what the recordings can show."""
        return {"delay_s": (0.0, LONGEST * extent.duration_s)}

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the least-squares delay: a short delay subtracts velocity times delay."""
        velocity = np.gradient(evidence.displacement_um, evidence.sample_period_s)
        gains, _ = evidence.reduction(-velocity[:, None])
        delay_s = float(np.clip(gains[0], 0.0, LONGEST * evidence.duration_s))
        return [cls(delay_s), cls(2.0 * delay_s)] if delay_s > 0.0 else []

    @classmethod
    def lacks_excitation(cls, evidence: Evidence) -> str | None:
        """Require fast motion, as a delay has no effect on slow motion."""
        step_um = np.sqrt(np.mean(np.diff(evidence.displacement_um) ** 2))
        if step_um < 0.01 * evidence.noise_um:
            return "the displacement moves too slowly for a delay to show"
        return None


def _lagrange(place: float) -> list[float]:
    """Return the Lagrange weights of values at 0 to `CUBIC` for the value at a place."""
    nodes = np.arange(CUBIC + 1)
    return [float(np.prod([(place - other) / (node - other) for other in nodes if other != node]))
            for node in nodes]
