# SPDX-License-Identifier: BSD-3-Clause
"""Progress on a terminal: one line that is overwritten, or a line for each step in a log."""

import shutil
import sys
import time
from typing import TextIO

REDRAW_PERIOD_S = 0.1
BAR_WIDTH = 20


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
