# SPDX-License-Identifier: BSD-3-Clause
"""Programs of the stage: a sequence of phases."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from piezo_stage_driver.engine.sources import FadeOver, Hold, Source, Volts


class StageRefusal(ValueError):
    """A command that the stage cannot accept now."""


@dataclass
class Phase:
    """A number of samples from one source; ``samples`` is infinite if only a stop ends it."""

    name: str
    source: Source
    samples: float
    flag: int
    marks: Source | None = None
    """Marks of the samples; None if no sample has one."""


class Program:
    """A sequence of phases, and the position in it; phases without samples are omitted.

    It ends with a return to rest, which takes some samples, unless it holds its last voltage.
    """

    def __init__(self, phases: Iterable[Phase] = (), way_back_samples: int = 0,
                 hold_at_end: bool = False):
        self.hold_at_end = hold_at_end
        self._phases = deque(phase for phase in phases if phase.samples > 0)
        self._samples = sum(phase.samples for phase in phases) + way_back_samples
        self._done_samples = 0

    @property
    def over(self) -> bool:
        """Return whether every phase has been played."""
        return not self._phases

    @property
    def phase_name(self) -> str:
        """Return the name of the present phase; ``rest`` if there is none."""
        return self._phases[0].name if self._phases else "rest"

    @property
    def fraction(self) -> float:
        """Return the fraction of the whole program that is done (0 to 1)."""
        return min(1.0, self._done_samples / self._samples) if self._samples else 1.0

    @property
    def samples_left(self) -> float:
        """Return the remaining samples of the whole program; infinite until a stop."""
        return max(0.0, self._samples - self._done_samples)

    def phase(self, voltage_v: Volts) -> Phase:
        """Return the present phase, or one that holds this voltage."""
        return self._phases[0] if self._phases else Phase("rest", Hold(voltage_v), math.inf, 0)

    def replace(self, phase: Phase) -> None:
        """Replace all phases by another last phase."""
        self._phases = deque([phase] if phase.samples > 0 else [])
        self._samples = self._done_samples + phase.samples

    def fade_over(self, source: Source, samples: int) -> None:
        """Fade the present phase over to another source within some samples."""
        self._phases[0].source = FadeOver(self._phases[0].source, source, samples)

    def advance(self, count: int) -> Phase | None:
        """Count played samples; return the phase that ends with them, or None."""
        self._done_samples += count
        if not self._phases:
            return None
        self._phases[0].samples -= count
        return self._phases.popleft() if self._phases[0].samples <= 0 else None
