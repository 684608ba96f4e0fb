# SPDX-License-Identifier: BSD-3-Clause
"""A small table for terminals, notebooks and pandas."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas

Cell = str | float | None
"""Text, a number, or None for an unknown value."""

DIGITS = 5
"""Significant digits of a number."""

DIGITS_OF_DEVIATION = 2
"""Significant digits of a standard deviation."""

MOST_DECIMALS = 7
"""Maximum number of decimals; smaller numbers are written with an exponent."""

DEVIATION = "std. dev."
"""Head of a column with the standard deviations of the column before it."""


@dataclass(frozen=True, repr=False, eq=False)
class SummaryTable:
    """A table with a title."""

    title: str
    """Title of one line."""
    heads: tuple[str, ...]

    rows: list[tuple[Cell, ...]]
    """Rows with as many cells as heads."""
    notes: tuple[str, ...] = ()
    """Sentences below the table."""

    def __repr__(self) -> str:
        cells = [self.heads, *self._texts()]
        widths = [max(len(row[column]) for row in cells) for column in range(len(self.heads))]
        left = self._are_texts()
        lines = ["  ".join(text.ljust(width) if is_text else text.rjust(width)
                           for text, width, is_text in zip(row, widths, left, strict=True)).rstrip()
                 for row in cells]
        rule = "  ".join("-" * width for width in widths)
        return "\n".join([self.title, *(["", lines[0], rule, *lines[1:]] if self.rows else []),
                          *(("", *self.notes) if self.notes else ())])

    def _repr_html_(self) -> str:
        left = self._are_texts()
        heads = _html_row("th", self.heads, left)
        body = "".join(_html_row("td", row, left) for row in self._texts())
        notes = "".join(f"<p>{escape(note)}</p>" for note in self.notes)
        return (f"<table><caption>{escape(self.title)}</caption><thead>{heads}</thead>"
                f"<tbody>{body}</tbody></table>{notes}")

    def to_frame(self) -> "pandas.DataFrame":
        """Return the rows as a pandas frame, numbers as numbers; ImportError without pandas."""
        import pandas

        return pandas.DataFrame(self.rows, columns=list(self.heads))

    def _texts(self) -> Iterator[tuple[str, ...]]:
        """Yield the rows as texts; a number with a deviation is rounded accordingly."""
        following = [*self.heads[1:], ""]
        for row in self.rows:
            next_column = [*row[1:], None]
            yield tuple(
                _deviation_text(cell) if head.startswith(DEVIATION)
                else _number_text(cell, after if next_head.startswith(DEVIATION) else None)
                for cell, head, after, next_head in zip(
                    row, self.heads, next_column, following, strict=True))

    def _are_texts(self) -> list[bool]:
        return [any(isinstance(row[column], str) for row in self.rows)
                for column in range(len(self.heads))]


def _number_text(cell: Cell, deviation: Any = None) -> str:
    if cell is None or isinstance(cell, str):
        return cell or ""
    if _is_known(deviation) and _decimals(deviation) <= MOST_DECIMALS:
        return f"{cell:.{_decimals(deviation)}f}"
    return f"{cell:.{DIGITS}g}"


def _deviation_text(cell: Any) -> str:
    if not _is_known(cell):
        return ""
    if _decimals(cell) <= MOST_DECIMALS:
        return f"{cell:.{_decimals(cell)}f}"
    return f"{cell:.{DIGITS_OF_DEVIATION}g}"


def _decimals(deviation: float) -> int:
    """Return the decimals for the significant digits of a deviation; 0 for a large one."""
    return max(0, DIGITS_OF_DEVIATION - 1 - int(np.floor(np.log10(deviation))))


def _is_known(deviation: Any) -> bool:
    return isinstance(deviation, int | float) and bool(np.isfinite(deviation)) and deviation > 0.0


def _html_row(kind: str, texts: Sequence[str], left: Sequence[bool]) -> str:
    cells = "".join(f'<{kind} style="text-align:{"left" if is_text else "right"}">'
                    f"{escape(text)}</{kind}>"
                    for text, is_text in zip(texts, left, strict=True))
    return f"<tr>{cells}</tr>"
