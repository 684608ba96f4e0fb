# SPDX-License-Identifier: BSD-3-Clause
"""Tables of the studies as text and as Markdown."""

from collections.abc import Iterable, Sequence


def text_table(rows: Iterable[Sequence[str]]) -> str:
    """Return rows of cells as text with aligned columns."""
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows)


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]],
                   right: Sequence[str] = ()) -> str:
    """Return a table as Markdown, ending with a new line; `right` names columns of numbers."""
    rule = "".join("---:|" if head in right else "---|" for head in heads)
    head, *lines = (f"| {' | '.join(cells)} |\n" for cells in (heads, *rows))
    return f"{head}|{rule}\n{''.join(lines)}"
