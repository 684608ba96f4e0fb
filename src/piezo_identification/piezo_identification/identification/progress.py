# SPDX-License-Identifier: BSD-3-Clause
"""Report the progress of an identification, and end it on request."""

from collections.abc import Callable


class IdentificationCancelled(Exception):
    """The identification was cancelled from outside."""


class Stages:
    """The stages of an identification, reported when they begin."""

    def __init__(self, progress: Callable[[str, float], object] | None = None,
                 cancelled: Callable[[], bool] | None = None) -> None:
        self._progress, self._cancelled = progress, cancelled
        self._stage = "reading"

    def check(self) -> None:
        """Raise `IdentificationCancelled` if the work is to end."""
        if self._cancelled is not None and self._cancelled():
            raise IdentificationCancelled(f"identification cancelled: {self._stage}")

    @property
    def current(self) -> str:
        """Current stage."""
        return self._stage

    def begin(self, stage: str, fraction: float) -> None:
        """Report that a stage begins, unless the work is to end."""
        self._stage = stage
        self.check()
        if self._progress is not None:
            self._progress(stage, fraction)

    def part(self, start: float, share: float) -> Callable[[str, float], None]:
        """Return a function that reports the stages of a part of the work."""
        return lambda stage, fraction: self.begin(stage, start + share * fraction)
