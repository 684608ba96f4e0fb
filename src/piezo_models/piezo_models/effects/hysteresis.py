# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis that the model lacks or has in another shape: plays in front of it."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter
from piezo_models.linear.dynamics import simulate_linear, zoh

SCANNED_THRESHOLDS = np.array([0.0, *np.geomspace(0.01, 0.9, 28)])
"""Half widths of the plays that are tried, over half the range; a play of 1 would never move. The
play of width zero is a change of the gain, which may be negative."""

MOST_PLAYS = 8
"""Largest number of plays; in a fit with non-negative weights most unneeded ones have none."""

FARTHEST = 1.5
"""Half ranges up to which the curvature is modelled; beyond, its contribution is constant."""

LEAST_SHARE = 0.2
"""The plays must remove at least this fraction of the residual's power, beyond a curve without
hysteresis, or they are not fitted: missing hysteresis is a large part of a residual."""

SCANNED_FIRST = slice(0, None, 5)
"""Plays that are tried first; all are tried if these remove half of `LEAST_SHARE` beyond a line."""

SOFTEST = 0.02
"""Smallest remaining slope, relative to that without hysteresis."""

LEAST_REVERSALS = 2


@njit(cache=True, nogil=True)
def plays_of(x: FloatArray, thresholds: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the outputs of plays, and overwrite their positions with the final ones."""
    outputs = np.empty((x.size, thresholds.size))
    for n in range(x.size):
        for i in range(thresholds.size):
            positions[i] = min(max(positions[i], x[n] - thresholds[i]), x[n] + thresholds[i])
            outputs[n, i] = positions[i]
    return outputs


@dataclass(frozen=True)
class Hysteresis(Effect):
    """Plays on the voltage, each followed by a line and a parabola.

    Let x be the voltage scaled to -1 to 1 over its range, p_i(x) the plays whose half widths are
    the thresholds, and h half the range. The effect adds h sum(weight_i p_i + curvature_i p_i^2): a
    generalised Prandtl-Ishlinskii operator. The parabolas make the ascending branch differ from the
    descending one.
    """

    name: ClassVar[str] = "hysteresis"
    place: ClassVar[str] = "voltage"
    experiment: ClassVar[str] = "hysteresis: slow triangles of rising amplitude"
    distortion: ClassVar[frozenset[str] | None] = frozenset({"odd"})

    weights: tuple[float, ...] = parameter("1", "linear", -3.0, 3.0)
    curvatures: tuple[float, ...] = parameter("1", "linear", -3.0, 3.0)
    thresholds: tuple[float, ...] = parameter("1", "fixed", 0.0, 1.0)
    centre_v: float = parameter("V", "fixed")
    half_range_v: float = parameter("V", "fixed", LEAST, MOST)

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, as `Effect.apply` describes."""
        past = None if rest is None else self._resting(rest)
        return self.advance(signal, sample_period_s, past)[0]

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the signal behind the effect; the past is the positions of the plays."""
        positions = self._resting(float(signal[0])) if past is None else past.copy()
        added = self._parts(signal, positions)
        return signal + added @ np.array([*self.weights, *self.curvatures]), positions

    def parts(self, signal: FloatArray) -> FloatArray:
        """Return the contribution of each part of weight 1: plays, then their squares."""
        return self._parts(signal, self._resting(float(signal[0])))

    def _resting(self, level: float) -> FloatArray:
        return np.full(len(self.thresholds), (level - self.centre_v) / self.half_range_v)

    def _parts(self, signal: FloatArray, positions: FloatArray) -> FloatArray:
        x = np.ascontiguousarray((signal - self.centre_v) / self.half_range_v)
        plays = plays_of(x, np.array(self.thresholds), positions)
        return self.half_range_v * np.hstack([plays, np.clip(plays, -FARTHEST, FARTHEST) ** 2])

    def impossible(self, extent: Extent) -> str | None:
        """Reject a displacement that decreases while the voltage rises."""
        weights, curvatures, thresholds = (
            np.array(each) for each in (self.weights, self.curvatures, self.thresholds))
        # A larger swing moves more plays; each lies within the remaining range.
        slopes = [1.0 + np.cumsum(weights + side * 2.0 * curvatures * (1.0 - thresholds))
                  for side in (-1.0, 1.0)]
        if np.min(slopes) < SOFTEST:
            return "the stage would go back while the voltage goes on"
        return None

    @classmethod
    def lacks_excitation(cls, evidence: Evidence) -> str | None:
        """Require a voltage that reverses."""
        if _large_reversals(evidence.voltage_v) < LEAST_REVERSALS:
            return "the voltage does not turn around twice by a tenth of its range"
        return None

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the least-squares plays, if they remove enough of the residual."""
        low, high = float(evidence.voltage_v.min()), float(evidence.voltage_v.max())
        shape = cls((), (), tuple(SCANNED_THRESHOLDS), 0.5 * (low + high), 0.5 * (high - low))
        few = replace(shape, thresholds=tuple(SCANNED_THRESHOLDS[SCANNED_FIRST]))
        plays = few._contributions(evidence, slice(0, len(few.thresholds)))
        _, of_line = evidence.reduction(plays[:, :1])
        if evidence.reduction(plays)[1] - of_line < 0.5 * LEAST_SHARE:
            return []
        plays = shape._contributions(evidence, slice(0, SCANNED_THRESHOLDS.size))
        weights, _ = evidence.reduction(np.column_stack([-plays[:, 0], plays]), positive=True)
        # The effect of a play grows with its width.
        matters = weights[1:] * SCANNED_THRESHOLDS
        count = min(MOST_PLAYS, int(np.count_nonzero(matters)))
        if count == 0:
            return []
        chosen = np.array([0, *np.sort(np.argsort(-matters)[:count])])
        squares = replace(shape, thresholds=tuple(SCANNED_THRESHOLDS[chosen]))._contributions(
            evidence, slice(chosen.size, None))
        _, curved_share = evidence.reduction(np.column_stack([plays[:, 0], squares[:, 0]]))
        gains, share = evidence.reduction(np.column_stack([plays[:, chosen], squares]))
        if share - curved_share < LEAST_SHARE:
            return []
        fitted, curvatures = np.split(np.clip(gains, -3.0, 3.0), 2)
        return [replace(shape, weights=tuple(fitted), curvatures=tuple(curvatures),
                        thresholds=tuple(SCANNED_THRESHOLDS[chosen]))]

    def _contributions(self, evidence: Evidence, numbers: slice) -> FloatArray:
        """Return what some parts would add to the displacement if the model there were a gain."""
        gain = evidence.travel_um / (2.0 * self.half_range_v)
        dynamics = zoh(evidence.dynamics.state_space(), evidence.sample_period_s)
        return np.column_stack([
            gain * simulate_linear(dynamics, np.ascontiguousarray(part))
            for part in self.parts(evidence.voltage_v).T[numbers]])


def _large_reversals(voltage_v: FloatArray) -> int:
    """Count the reversals after which the voltage returns by at least a tenth of its range."""
    outputs = plays_of(np.ascontiguousarray(voltage_v, dtype=float),
                     np.array([0.05 * np.ptp(voltage_v)]), np.array([float(voltage_v[0])]))[:, 0]
    moves = np.sign(np.diff(outputs))
    moves = moves[moves != 0.0]
    return int(np.count_nonzero(moves[1:] != moves[:-1]))
