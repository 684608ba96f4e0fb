# SPDX-License-Identifier: BSD-3-Clause
"""Report the progress of an identification, explain its failures, and end it on request."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import numpy as np


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

    def begin(self, stage: str, fraction: float) -> None:
        """Report that a stage begins at a fraction of the work, unless the work is to end."""
        self._stage = stage
        self.check()
        if self._progress is not None:
            self._progress(stage, fraction)

    def part(self, start: float, share: float) -> Callable[[str, float], None]:
        """Return a function that takes (stage, fraction of a part) and reports the stages of it."""
        return lambda stage, fraction: self.begin(stage, start + share * fraction)

    @contextmanager
    def failures_explained(self, paths: Iterable[object]) -> Iterator[None]:
        """Turn a failure of linear algebra into an error that names the stage and the recordings.

        Raise ValueError instead of `numpy.linalg.LinAlgError`.
        """
        try:
            yield
        except np.linalg.LinAlgError as error:
            named = ", ".join(map(str, paths))
            raise ValueError(
                f"{self._stage}: cannot be computed from {named} ({error}): a recording does not "
                "show what it was given for; look at each with check, and leave out those that do "
                "not fit") from error
