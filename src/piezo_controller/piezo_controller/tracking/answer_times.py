# SPDX-License-Identifier: BSD-3-Clause
"""Histogram of the time that the answers of a run took to compute."""

import numpy as np

BOUNDS_S = np.geomspace(1e-6, 100.0, 161)
"""Bounds of the histogram (s), twenty per decade: a percentile is exact to 12 %."""


class AnswerTimes:
    """Histogram of computing times, which takes the same memory for a run of any length.

    Answers that take longer than the limit are late.
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
        """Return the bound (s) within which that percentage of the answers came.

        It is infinite beyond the last bound.
        """
        reached = np.searchsorted(np.cumsum(self._counts), percent / 100 * self.count)
        return float(np.append(BOUNDS_S, np.inf)[reached])
