# SPDX-License-Identifier: BSD-3-Clause
"""Lines below the last row of a text table: means, totals, the end of a log."""

from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path

from piezo_recorder.reading.tables.dialect import Dialect, is_comment

TAIL_BYTES = 1 << 14
MOST_LINES = 40
"""Largest number of lines; a longer end without rows is damage, and reported at its beginning."""


def footer_lines(path: Path, encoding: str, dialect: Dialect) -> list[str]:
    """Return the lines at the end of a file that begin with text, unlike the rows.

    Returns
    -------
    list of str
        Includes comments and empty lines between and below them; empty if the last line with any
        content is a row, or the end without rows is long.
    """
    if dialect.kinds[0] == "text":
        return []
    with open(path, "rb") as file:
        size = file.seek(0, 2)
        # Two-byte characters begin at even positions.
        start = max(size - TAIL_BYTES, 0) // 2 * 2
        file.seek(start)
        text = file.read().decode(encoding, errors="replace")
    lines = text.splitlines()[1 if start else 0:]
    count = 0
    for number, line in enumerate(reversed(lines), start=1):
        if is_comment(line):
            continue
        cells = dialect.split(line)
        if dialect.kind(cells[0]) != "text" or cells[0] in dialect.header:
            break
        count = number
    return lines[len(lines) - count:] if 0 < count <= MOST_LINES else []


def without_last(lines: Iterable[str], count: int) -> Iterator[str]:
    """Yield all lines except the last ones."""
    held: deque[str] = deque()
    for line in lines:
        held.append(line)
        if len(held) > count:
            yield held.popleft()
