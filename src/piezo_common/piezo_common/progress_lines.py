# SPDX-License-Identifier: BSD-3-Clause
"""Progress of a command as lines of text, of which none comes late."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from piezo_common.budget import Budget

SILENT_S = 4.0
"""Time after which what goes on is printed again."""

TELLING = 0.05
"""Part of the work from which the time taken so far tells what is left."""


class ProgressLines:
    """Print which step a command is at, and for a long one how long it has gone on.

    The time that is left is estimated where a step begins, and runs down until the next one.

    Parameters
    ----------
    budget : Budget
        Of the command: what is left is no more than it has.
    clock : callable
        Returns seconds.
    """

    def __init__(self, budget: Budget, clock: Callable[[], float] = time.monotonic) -> None:
        self._budget, self._clock = budget, clock
        self._begun_s = self._printed_s = clock()
        self._stage, self._fraction = "", 0.0
        self._whole_s: float | None = None
        self._one_at_a_time = threading.Lock()

    def report(self, stage: str, fraction: float) -> None:
        """Print that a step begins, and which part of the whole is done (0 to 1)."""
        with self._one_at_a_time:
            self._stage, self._fraction = stage, fraction
            taken_s = self._clock() - self._begun_s
            is_known = TELLING <= fraction < 1.0 and taken_s >= 1.0
            self._whole_s = taken_s / fraction if is_known else None
            self._print()

    def beat(self) -> None:
        """Print again what goes on, unless something was printed just now."""
        with self._one_at_a_time:
            if self._stage and self._clock() - self._printed_s >= SILENT_S:
                self._print()

    def _print(self) -> None:
        self._printed_s = self._clock()
        taken_s = self._printed_s - self._begun_s
        words = [f"{100.0 * self._fraction:3.0f} %  {self._stage}"]
        if self._fraction < 1.0 and taken_s >= 1.0:
            words.append(f"{taken_s:.0f} s so far{self._left(taken_s)}")
        print(", ".join(words), flush=True)

    def _left(self, taken_s: float) -> str:
        """Return how long the command still takes, as far as that is known."""
        if not self._budget.left_s:
            return "; the time is over, this step ends"
        if self._whole_s is None:
            return ""
        left_s = min(self._whole_s - taken_s, self._budget.left_s)
        return f", about {left_s:.0f} s left" if left_s > 0.5 else ", longer than expected"


@contextmanager
def progress_printed(budget: Budget) -> Iterator[Callable[[str, float], None]]:
    """Give a function that prints the progress, called with (stage, fraction).

    While the context lasts, nothing is silent for longer than `SILENT_S` and a second.
    """
    lines, is_over = ProgressLines(budget), threading.Event()

    def beat() -> None:
        while not is_over.wait(1.0):
            lines.beat()

    beats = threading.Thread(target=beat, name="progress", daemon=True)
    beats.start()
    try:
        yield lines.report
    finally:
        is_over.set()
        beats.join()
