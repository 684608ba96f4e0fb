# SPDX-License-Identifier: BSD-3-Clause
"""Progress of a command, at least every few seconds: lines of text, or one line of a terminal."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from piezo_common.budget import Budget
from piezo_common.progress_line import overwrite

SILENT_S = 4.0
"""Time in s without output after which the present step is printed again."""

FIRST_ESTIMATE = 0.05
"""Fraction of the work from which the remaining time is estimated."""


class ProgressLines:
    """Print the present step of a command, and the time taken so far if it is long.

    A terminal shows one line, which changes; a file or another program gets all lines. The
    remaining time is estimated at the beginning of a step, and counts down until the next one; the
    budget of the command bounds it.
    """

    def __init__(self, budget: Budget, clock: Callable[[], float] = time.monotonic) -> None:
        self._budget, self._clock = budget, clock
        self._begun_s = self._printed_s = clock()
        self._stage, self._fraction = "", 0.0
        self._whole_s: float | None = None
        self._one_at_a_time = threading.Lock()

    def report(self, stage: str, fraction: float) -> None:
        """Print the beginning of a step, and the fraction of the whole that is done (0 to 1)."""
        with self._one_at_a_time:
            self._stage, self._fraction = stage, fraction
            taken_s = self._clock() - self._begun_s
            is_known = FIRST_ESTIMATE <= fraction < 1.0 and taken_s >= 1.0
            self._whole_s = taken_s / fraction if is_known else None
            self._print()

    def beat(self) -> None:
        """Print the present step again, unless something was printed recently."""
        with self._one_at_a_time:
            if self._stage and self._clock() - self._printed_s >= SILENT_S:
                self._print()

    def _print(self) -> None:
        self._printed_s = self._clock()
        taken_s = self._printed_s - self._begun_s
        words = [f"{100.0 * self._fraction:3.0f} %  {self._stage}"]
        if self._fraction < 1.0 and taken_s >= 1.0:
            words.append(f"{taken_s:.0f} s so far{self._left(taken_s)}")
        _show(", ".join(words))

    def _left(self, taken_s: float) -> str:
        """Return the remaining time as text; empty if it is unknown."""
        if not self._budget.left_s:
            return "; the time is over, this step ends"
        if self._whole_s is None:
            return ""
        left_s = min(self._whole_s - taken_s, self._budget.left_s)
        if left_s < 0.0:
            return ", longer than expected"
        return f", about {left_s:.0f} s left" if left_s > 0.5 else ""


def _show(text: str) -> None:
    """Print a line; on a terminal, in the place of the one before."""
    if sys.stdout.isatty():
        overwrite(sys.stdout, text)
    elif text:
        print(text, flush=True)


@contextmanager
def progress_printed(budget: Budget) -> Iterator[Callable[[str, float], None]]:
    """Provide a function that prints progress, called with (stage, fraction).

    Within the context, the present step is printed again after `SILENT_S` and up to a second.
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
        _show("")
