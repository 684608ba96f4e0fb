# SPDX-License-Identifier: BSD-3-Clause
"""Wait as long as there is progress, as durations depend on the load of the computer."""

import time
from collections.abc import Callable


class Patience:
    """Detect when nothing has changed for longer than a limit (s)."""

    def __init__(self, limit_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._limit_s, self._clock = limit_s, clock
        self._state: object = None
        self._since_s = clock()

    def ended(self, state: object = None) -> bool:
        """Return whether this state, compared by equality, has lasted for longer than the limit."""
        now_s = self._clock()
        if state != self._state:
            self._state, self._since_s = state, now_s
        return now_s - self._since_s > self._limit_s
