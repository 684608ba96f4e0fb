# SPDX-License-Identifier: BSD-3-Clause
"""Lines below the last row of a text table: means, totals, the end of a log."""

from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path

from piezo_recorder.reading.tables.dialect import Dialect, is_comment

TAIL_BYTES = 1 << 14
MOST_LINES = 40
"""A longer end without rows is damage, and is refused where it begins."""


def footer_lines(path: Path, encoding: str, dialect: Dialect) -> list[str]:
    """Return the lines at the end of a file that begin with a text where rows do not.

    Returns
    -------
    list of str
        Comments and empty lines between and below them included; empty where the last line that
        says anything is a row, or the end without rows is long.
    """
    if dialect.kinds[0] == "text":
        return []
    with open(path, "rb") as file:
        size = file.seek(0, 2)
        # Characters of two bytes begin at an even place.
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
    """Give all lines but the last ones."""
    held: deque[str] = deque()
    for line in lines:
        held.append(line)
        if len(held) > count:
            yield held.popleft()
