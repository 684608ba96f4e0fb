# SPDX-License-Identifier: BSD-3-Clause
"""Progress on a terminal: one line that is overwritten, or lines of text in a log."""

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

from piezo_common.budget import Budget

REDRAW_PERIOD_S = 0.1
BAR_WIDTH = 20

SILENT_S = 4.0
"""Time in s without output after which the present step is printed again."""

FIRST_ESTIMATE = 0.05
"""Fraction of the work from which the remaining time is estimated."""


class ProgressLine:
    """Show the present step, the fraction done and the remaining time.

    If the stream is not a terminal, each new step gets its own line without a bar.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._overwrites = self._stream.isatty()
        self._step: str | None = None
        self._drawn_at = 0.0

    def show(self, step: str, fraction: float, seconds_left: float | None = None) -> None:
        """Show the fraction of a step that is done (0 to 1), and the seconds left if known."""
        new = step != self._step
        self._step = step
        if not self._overwrites:
            if new:
                print(step, file=self._stream, flush=True)
            return
        if new or time.monotonic() - self._drawn_at >= REDRAW_PERIOD_S:
            self._drawn_at = time.monotonic()
            overwrite(self._stream, progress_text(step, fraction, seconds_left))

    def clear(self) -> None:
        """Clear the line for the next output."""
        self._step = None
        if self._overwrites:
            overwrite(self._stream, "")


def overwrite(terminal: TextIO, text: str) -> None:
    """Write a text in place of the present line of a terminal.

    What is written next, such as a warning, begins in the same line.
    """
    width = shutil.get_terminal_size().columns - 1
    terminal.write(f"\r\x1b[K{text[:width]}\r")
    terminal.flush()


def progress_text(step: str, fraction: float, seconds_left: float | None) -> str:
    """Return a bar, the percentage, the seconds left and the step as one line of text."""
    filled = round(BAR_WIDTH * min(max(fraction, 0.0), 1.0))
    bar = "#" * filled + "." * (BAR_WIDTH - filled)
    left = "" if seconds_left is None else f"{seconds_left:.0f} s left"
    return f"[{bar}] {100 * fraction:3.0f} %  {left:>10}  {step}"


class CommandProgress:
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
    lines, is_over = CommandProgress(budget), threading.Event()

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
