# SPDX-License-Identifier: BSD-3-Clause
"""How long the answers of a run took to compute, as counts between bounds."""

import numpy as np

BOUNDS_S = np.geomspace(1e-6, 100.0, 161)
"""Twenty to a decade: a percentile is told to 12 %."""


class AnswerTimes:
    """Counts of computing times: a run of any length takes the same memory.

    Parameters
    ----------
    limit_s : float
        Answers beyond it are late (s).
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._counts = np.zeros(BOUNDS_S.size + 1, dtype=np.int64)
        self.count = self.late = 0

    def add(self, time_s: float) -> None:
        """Count one answer."""
        self.count += 1
        self.late += time_s > self._limit_s
        self._counts[np.searchsorted(BOUNDS_S, time_s)] += 1

    def percentile_s(self, percent: float) -> float:
        """Return time (s) within which so many percent of the answers came, up to the next bound.

        Infinite beyond the last bound.
        """
        reached = np.searchsorted(np.cumsum(self._counts), percent / 100 * self.count)
        return float(np.append(BOUNDS_S, np.inf)[reached])
