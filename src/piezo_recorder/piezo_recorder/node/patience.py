# SPDX-License-Identifier: BSD-3-Clause
"""Wait as long as there is progress: how long it takes depends on how busy the computer is."""

import time
from collections.abc import Callable


class Patience:
    """Tell when nothing has changed for too long.

    Parameters
    ----------
    limit_s : float
        Of the time without a change.
    clock : callable
        Returns the present time (s).
    """

    def __init__(self, limit_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._limit_s, self._clock = limit_s, clock
        self._state: object = None
        self._since_s = clock()

    def ended(self, state: object = None) -> bool:
        """Tell whether this state, compared by equality, has been there for longer than the limit.

        Parameters
        ----------
        state : object
            What changes while there is progress.
        """
        now_s = self._clock()
        if state != self._state:
            self._state, self._since_s = state, now_s
        return now_s - self._since_s > self._limit_s
