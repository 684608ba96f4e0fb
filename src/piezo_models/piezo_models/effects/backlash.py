# SPDX-License-Identifier: BSD-3-Clause
"""Play of a joint between actuator and stage.

After a reversal, a play of width w follows a motion F only beyond w. Preisach hysteresis with an
Everett function F(alpha, beta), followed by a play, is therefore equivalent to Preisach hysteresis
with max(F - w, 0): quasistatic loops cannot distinguish them. For the inverse, F is the given
function plus w. Smaller motion is not visible; its gain is taken from where the play is taken up.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter
from piezo_models.effects.hysteresis import plays_of
from piezo_models.hysteresis.preisach import PreisachModel

TAKEN_UP = 3.0
"""Motion in widths of the play after which it is taken up, for any resolution of the density."""


@dataclass(frozen=True)
class Backlash(Effect):
    """After each reversal the stage rests until the play is taken up."""

    name: ClassVar[str] = "backlash"
    place: ClassVar[str] = "displacement"
    experiment: ClassVar[str] = "hysteresis: harmonics of small and large amplitude"
    distortion: ClassVar[frozenset[str] | None] = frozenset({"odd"})

    width_um: float = parameter("um", "logarithm", LEAST, MOST)

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal behind the effect, as `Effect.apply` describes."""
        return self.advance(signal, sample_period_s, rest)[0]

    def advance(self, signal: FloatArray, sample_period_s: float,
                past: Any = None) -> tuple[FloatArray, Any]:
        """Continue the signal behind the effect; the past is the position of the stage."""
        start = float(signal[0] if past is None else past)
        behind = plays_of(np.ascontiguousarray(signal), np.array([0.5 * self.width_um]),
                          np.array([start])).ravel()
        return behind, float(behind[-1])

    def compensate(self, wanted: FloatArray, sample_period_s: float) -> FloatArray:
        """Shift the wanted motion so that the play is taken up at once after each reversal."""
        ahead = np.sign(np.diff(np.tile(wanted, 2), append=wanted[0]))
        for n in range(1, ahead.size):
            if ahead[n] == 0.0:
                ahead[n] = ahead[n - 1]
        return wanted + 0.5 * self.width_um * ahead[wanted.size :]

    def hysteresis_ahead(self, hysteresis: PreisachModel) -> PreisachModel:
        """Return the hysteresis without the play, as `Effect.hysteresis_ahead` describes."""
        return without_play(hysteresis, self.width_um)

    @classmethod
    def bounds(cls, extent: Extent) -> dict[str, tuple[float, float]]:
        """Bound the width to a play that leaves some motion."""
        return {"width_um": (1e-9 * extent.travel_um, 0.5 * extent.travel_um)}

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with widths from the noise to a tenth of the travel."""
        high = 0.1 * evidence.travel_um
        if high <= evidence.noise_um:
            return []
        return [cls(width) for width in np.geomspace(max(evidence.noise_um, 1e-6 * high), high, 8)]


def without_play(hysteresis: PreisachModel, width_um: float) -> PreisachModel:
    """Return the hysteresis that is equivalent to the given one if a play follows it.

    It has the same grid. If the given one has more motion just after a reversal than the play
    allows, the excess is lost.
    """
    levels_v, cell_v = hysteresis.levels_v, hysteresis.cell_width_v
    seen_um = hysteresis.everett_um(levels_v[:, None], levels_v[None, :]) + width_um
    cells = np.maximum(np.subtract.outer(np.arange(levels_v.size), np.arange(levels_v.size)), 0)
    apart = np.arange(1, levels_v.size)
    mean_um = np.array([np.mean(np.diagonal(seen_um, -each)) for each in apart])
    early = mean_um <= max(TAKEN_UP * width_um, mean_um[0])
    taken_up = 1 + int(np.argmin((mean_um / apart)[early]))
    unseen_um = mean_um[taken_up - 1] / taken_up * cells
    everett_um = np.where(cells <= taken_up, unseen_um, seen_um)
    within = everett_um[1:, :-1] - everett_um[:-1, :-1] - everett_um[1:, 1:] + everett_um[:-1, 1:]
    return replace(
        hysteresis, density_um_per_v2=np.maximum(np.tril(within, -1), 0.0) / cell_v**2,
        reversible_um_per_v=np.diagonal(everett_um, -1) / cell_v)
