# SPDX-License-Identifier: BSD-3-Clause
"""Additional creep: relaxations over the decades of time that a recording covers."""

from dataclasses import dataclass
from typing import ClassVar, Self

import control
import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, parameter
from piezo_models.effects.filtering import filtered

PER_DECADE = 1.0
MOST_RELAXATIONS = 5
FEWEST_SAMPLES = 20
"""Smallest duration of the shortest relaxation in samples."""
SHORTEST_S = 0.01


@dataclass(frozen=True)
class Creep(Effect):
    """The displacement continues by the fractions `gains`, each with its own time constant.

    A sum over time constants a decade apart can also follow creep that is logarithmic in time.
    """

    name: ClassVar[str] = "creep"
    place: ClassVar[str] = "linear"
    experiment: ClassVar[str] = "creep: long square wave, steps held for minutes"
    distortion: ClassVar[frozenset[str] | None] = frozenset()
    confounded_with: ClassVar[tuple[str, ...]] = ("thermal_drift",)

    gains: tuple[float, ...] = parameter("1", "linear", 0.0, 1.0)
    time_constants_s: tuple[float, ...] = parameter("s", "fixed", LEAST, MOST)

    def state_space(self) -> control.StateSpace:
        """Return the continuous system, with unit gain at high frequency."""
        rates = 1.0 / np.array(self.time_constants_s)
        return control.ss(
            np.diag(-rates), rates[:, None], np.array(self.gains)[None, :], [[1.0]]
        )

    def response(self, s: ComplexArray) -> ComplexArray:
        """Return the factor of the effect in the frequency response."""
        response = np.ones_like(s)
        for gain, time_s in zip(self.gains, self.time_constants_s, strict=True):
            response = response + gain / (1.0 + s * time_s)
        return response

    def relaxations(self, signal: FloatArray, sample_period_s: float,
                    rest: float | None = None) -> FloatArray:
        """Return the contribution of each relaxation of gain 1, shape (N, n)."""
        return np.column_stack([
            filtered([1.0], [time_s, 1.0], signal, sample_period_s, rest)
            for time_s in self.time_constants_s
        ])

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, as `Effect.apply` describes."""
        rest = signal[0] if rest is None else rest
        # Creep from before the beginning is part of the offset.
        added = self.relaxations(signal - rest, sample_period_s, 0.0) @ self.gains
        return signal + added + rest * sum(self.gains)

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with time constants that cover the recording, and least-squares gains."""
        shortest_s = max(SHORTEST_S, FEWEST_SAMPLES * evidence.sample_period_s)
        longest_s = 0.5 * evidence.duration_s
        if longest_s <= 2.0 * shortest_s:
            return []
        count = int(np.clip(round(PER_DECADE * np.log10(longest_s / shortest_s)) + 1,
                            2, MOST_RELAXATIONS))
        time_constants_s = tuple(np.geomspace(shortest_s, longest_s, count))
        shape = cls((0.0,) * count, time_constants_s)
        gains, _ = evidence.reduction(
            shape.relaxations(evidence.displacement_um, evidence.sample_period_s)
        )
        return [cls(tuple(np.clip(gains, 1e-6, 0.5)), time_constants_s)]

    @classmethod
    def lacks_excitation(cls, evidence: Evidence) -> str | None:
        """Require a recording that is long enough for creep."""
        if evidence.duration_s < 10.0 * max(SHORTEST_S, evidence.sample_period_s):
            return f"the recording lasts only {evidence.duration_s:.3g} s"
        return None
