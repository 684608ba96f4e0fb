# SPDX-License-Identifier: BSD-3-Clause
"""Supply a stage with a feedforward that is computed while it plays."""

import threading
from collections.abc import Callable

from piezo_common.arrays import FloatArray

AHEAD_SAMPLES = 12000
LEAST_AHEAD_SAMPLES = 160


More = Callable[[], FloatArray | None]
"""Returns the next voltages in V: empty at the end, None while they are not available."""


class Stream:
    """Loaded and played samples, and responses that are delayed until more is loaded.

    Without a response a stage in lockstep waits, so that its motion does not depend on the
    computing time of the next chunk. A paced stage would miss the responses, and counts them.
    `append` loads a chunk after those samples that are loaded already; ``answer(tick, voltage_v)``
    sends a response to the stage.
    """

    def __init__(self, more: More, loaded_samples: int, append: Callable[[FloatArray], None],
                 answer: Callable[[int, float], None]) -> None:
        self._more, self._append, self._answer = more, append, answer
        self._loaded_samples = loaded_samples
        self._played_samples = 0
        self._ended = False
        # In order: a stage continues for a while before it misses the first of them.
        self._held_back: list[tuple[int, float]] = []
        self._lock = threading.Lock()

    @property
    def wants_more(self) -> bool:
        """Return True if more must be loaded."""
        return not self._ended and self._loaded_samples - self._played_samples < AHEAD_SAMPLES

    def feed(self) -> None:
        """Load chunks until enough is loaded, or the next one is not available."""
        while self.wants_more:
            chunk_v = self._more()
            if chunk_v is None:
                return
            if len(chunk_v):
                self._append(chunk_v)
            with self._lock:
                self._loaded_samples += len(chunk_v)
                self._ended = not len(chunk_v)
                if not self._scarce:
                    for held_back in self._held_back:
                        self._answer(*held_back)
                    self._held_back.clear()

    def answer(self, tick: int, voltage_v: float, played_samples: int) -> None:
        """Send a response, at once or when enough is loaded for the stage to continue."""
        with self._lock:
            self._played_samples += played_samples
            if self._scarce:
                self._held_back.append((tick, voltage_v))
            else:
                self._answer(tick, voltage_v)

    @property
    def _scarce(self) -> bool:
        ahead = self._loaded_samples - self._played_samples
        return not self._ended and ahead < LEAST_AHEAD_SAMPLES
