# SPDX-License-Identifier: BSD-3-Clause
"""Histograms of durations, such as the latency of the answers to blocks."""

import bisect
import time

REMEMBERED_TICKS = 1024
BOUNDS_MS = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)


class LatencyCounts:
    """Numbers (`counts`) of durations up to each of `BOUNDS_MS`, and beyond the last."""

    def __init__(self) -> None:
        self.counts = [0] * (len(BOUNDS_MS) + 1)
        self.longest_ms = 0.0

    def add(self, latency_ms: float) -> None:
        """Count one time (ms)."""
        self.counts[bisect.bisect_left(BOUNDS_MS, latency_ms)] += 1
        self.longest_ms = max(self.longest_ms, latency_ms)

    def described(self, counted: str, longest: str) -> dict[str, object]:
        """Return the counts with names such as ``ticks_within_0.5_ms``.

        The arguments name what is counted, such as ``ticks``, and the longest time.
        """
        names = [f"{counted}_within_{bound:g}_ms" for bound in BOUNDS_MS]
        return dict(zip([*names, f"{counted}_beyond_{BOUNDS_MS[-1]:g}_ms"], self.counts,
                        strict=True)) | {longest: f"{self.longest_ms:.3f}"}


class AnswerLatency(LatencyCounts):
    """Time from the publication of a block to the arrival of its answer."""

    def __init__(self) -> None:
        super().__init__()
        self._published = [(-1, 0.0)] * REMEMBERED_TICKS

    def published(self, tick: int) -> None:
        """Record that the block of a tick is published now."""
        self._published[tick % REMEMBERED_TICKS] = (tick, time.monotonic())

    def answered(self, tick: int) -> None:
        """Record that the answer for a tick has arrived, in time or late."""
        published_tick, published_s = self._published[tick % REMEMBERED_TICKS]
        if tick == published_tick:
            self.add(1e3 * (time.monotonic() - published_s))
