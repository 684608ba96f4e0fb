# SPDX-License-Identifier: BSD-3-Clause
"""Play of a joint between actuator and stage."""

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numba import njit

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import LEAST, MOST, Effect, Evidence, Extent, parameter
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.hysteresis.without_play import without_play


@njit(cache=True, nogil=True)
def _played(position: FloatArray, half_width: float, start: float) -> FloatArray:
    output = np.empty(position.size)
    last = start
    for n in range(position.size):
        last = min(max(last, position[n] - half_width), position[n] + half_width)
        output[n] = last
    return output


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
        behind = _played(np.ascontiguousarray(signal), 0.5 * self.width_um, start)
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
