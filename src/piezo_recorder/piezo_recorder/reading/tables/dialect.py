# SPDX-License-Identifier: BSD-3-Clause
"""The format of a text table: delimiter, decimal mark, header, and first row."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezo_recorder.reading.tables.cells import is_grouped, kind_of, number_of
from piezo_recorder.reading.units import is_unit

DELIMITERS = ("\t", ";", ",", "|", None)
"""Delimiters in the order in which they are tried; None is any white space."""

COMMENTS = ("#", "%", "//", "!")
"""Beginnings of lines that are not rows; a header may follow them."""

HEADER_WITHIN = 3
"""Lines above the first row that may contain its header: names, units, an empty line."""

_GLUED = re.compile(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?")


@dataclass(frozen=True)
class Dialect:
    """The format of a text table."""

    delimiter: str | None
    """None for any white space."""
    decimal: str
    """``.`` or ``,``."""
    cells: int
    """Number of cells in a row."""
    kinds: tuple[str, ...]
    """Kind of each cell of a row: ``number``, ``clock``, ``text`` or ``empty``."""
    header: tuple[str, ...] = ()
    """Labels of the columns; empty if the file has none."""
    units: tuple[str, ...] = ()
    """Units in a line below the header; empty if there is none."""
    header_line: int = -1
    """Line of the header, from 0; -1 if there is none."""
    first_line: int = 0
    """Line of the first row, from 0."""
    grouped: bool = False
    """Whether the file shows its decimal mark, so that the other one separates thousands."""

    def split(self, line: str) -> list[str]:
        """Return the cells of a line, without surrounding quotes and white space."""
        return split_cells(line, self.delimiter)

    def kind(self, cell: str) -> str:
        """Return the kind of a cell: ``number``, ``clock``, ``text`` or ``empty``."""
        return kind_of(cell, self.decimal, self.grouped)

    def number(self, cell: str) -> float:
        """Return the number in a cell; NaN if there is none."""
        return number_of(cell, self.decimal, self.grouped)

    def is_grouped(self, cell: str) -> bool:
        """Return whether a cell holds a number with thousands separators."""
        return is_grouped(cell, self.decimal)


def split_cells(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line; a delimiter in quotes does not separate cells."""
    line = line.strip("\r\n") if delimiter == "\t" else line.strip()
    if delimiter and '"' in line:
        cells = re.split(re.escape(delimiter) + r'(?=(?:[^"]*"[^"]*")*[^"]*$)', line)
    else:
        cells = line.split(delimiter)
    return [cell.strip().strip('"').strip() for cell in cells]


def is_comment(line: str) -> bool:
    """Return whether a line is empty or a comment."""
    text = line.lstrip("\ufeff \t\r\n")
    return not text or text.startswith(COMMENTS)


def dialect_of(lines: Sequence[str],
               delimiters: Sequence[str | None] = DELIMITERS) -> Dialect | None:
    """Determine the format from the first lines of a file; None if no line is a row.

    Rows are lines with the same number of cells, at least one of which is a number and none is
    text; in a table with a column of text at least two are numbers.
    """
    found = (_best(lines, delimiters, text_allowed=False)
             or _best(lines, delimiters, text_allowed=True))
    return _with_header(found, lines) if found else None


def _best(lines: Sequence[str], delimiters: Sequence[str | None],
          text_allowed: bool) -> Dialect | None:
    best, best_score = None, 0.0
    for decimal in ".,":
        for delimiter in delimiters:
            if delimiter == decimal:
                continue
            rows = _rows(lines, delimiter, decimal, text_allowed)
            if not rows:
                continue
            counts = Counter(len(kinds) for kinds in rows.values())
            cells = max(counts, key=lambda count: (counts[count], count))
            of_count = {line: kinds for line, kinds in rows.items() if len(kinds) == cells}
            share = np.mean([kinds.count("number") / cells for kinds in of_count.values()])
            score = len(of_count) * float(share)
            if score > best_score:
                first = min(of_count)
                best, best_score = Dialect(
                    delimiter, decimal, cells, of_count[first], first_line=first), score
    if best is not None and _shows_decimal_mark(best, lines):
        rows = _rows(lines, best.delimiter, best.decimal, text_allowed, grouped=True)
        first = min(line for line, kinds in rows.items() if len(kinds) == best.cells)
        best = replace(best, kinds=rows[first], first_line=first, grouped=True)
    return best and replace(best, first_line=_first_line(best, lines))


def _first_line(found: Dialect, lines: Sequence[str]) -> int:
    """Return the first row, also if other columns contain remarks next to the first rows."""
    first = found.first_line
    while first > 0:
        cells = found.split(lines[first - 1])
        numbers = [cell for cell, kind in zip(cells, found.kinds, strict=False)
                   if kind == "number"]
        if len(cells) != found.cells or any(found.kind(cell) != "number" for cell in numbers):
            break
        first -= 1
    return first


def _shows_decimal_mark(found: Dialect, lines: Sequence[str]) -> bool:
    """Return whether a cell has a decimal mark that cannot be a thousands separator."""
    thousands = re.compile(rf"[-+]?[1-9]\d{{0,2}}(?:{re.escape(found.decimal)}\d{{3}})+")
    cells = (cell for line in lines[found.first_line:] for cell in found.split(line))
    return any(found.decimal in cell and found.kind(cell) == "number"
               and not thousands.fullmatch(cell) for cell in cells)


def _rows(lines: Sequence[str], delimiter: str | None, decimal: str, text_allowed: bool,
          grouped: bool = False) -> dict[int, tuple[str, ...]]:
    """Return the kinds of the cells of every line that looks like a row."""
    found = {}
    for number, line in enumerate(lines):
        if is_comment(line):
            continue
        cells = split_cells(line, delimiter)
        if len(cells) < 2:
            continue
        kinds = tuple(kind_of(cell, decimal, grouped) for cell in cells)
        numbers = kinds.count("number")
        if numbers >= 2 if text_allowed else numbers >= 1 and "text" not in kinds:
            found[number] = kinds
    return found


def _with_header(found: Dialect, lines: Sequence[str]) -> Dialect:
    """Add the labels and units above the first row to a dialect."""
    above = range(found.first_line - 1, max(found.first_line - 2 - HEADER_WITHIN, -1), -1)
    units: tuple[str, ...] = ()
    units_line = 0
    for number in above:
        if not lines[number].strip():
            continue
        labels = _labels(lines[number], found)
        texts = [found.kind(label) == "text" for label in labels or () if label]
        # With a line of units below it, a header may have mostly numbers for names.
        if labels is None or not any(texts) or not units and sum(texts) < 0.5 * len(texts):
            continue
        if not units and _are_units(labels):
            units, units_line = labels, number
            continue
        if not units and _stands_below_units(lines, number, found):
            # For example the channels of a card, below names and units.
            continue
        return replace(found, header=labels, units=units, header_line=number)
    # There is nothing above the units, which are then the only names.
    return replace(found, header=units, header_line=units_line) if units else found


def _stands_below_units(lines: Sequence[str], number: int, found: Dialect) -> bool:
    """Return whether there is a line of units above a line, and names above that."""
    if number < 2:
        return False
    names, units = (_labels(lines[each], found) for each in (number - 2, number - 1))
    return bool(names and units) and _are_units(units or ()) and not _are_units(names or ())


def _labels(line: str, found: Dialect) -> tuple[str, ...] | None:
    """Return the labels of a header with as many cells as a row, or None."""
    text = line.strip().lstrip("\ufeff")
    while text.startswith(COMMENTS):
        text = text[1:].lstrip()
    splits = [split_cells(text, found.delimiter)]
    if found.delimiter is None:
        splits += [re.split(r"\t+|\s{2,}", text), _GLUED.findall(text),
                   split_cells(text, ","), split_cells(text, ";")]
    for cells in splits:
        # Each row, but not the header, ends with a delimiter.
        if len(cells) == found.cells - 1 and found.kinds[-1] == "empty":
            cells = [*cells, ""]
        # LabVIEW has a label for a last column that its rows omit.
        if len(cells) == found.cells + 1 and cells[-1].lower() in ("", "comment"):
            cells = cells[:-1]
        if len(cells) == found.cells:
            return tuple(cells)
    return None


def _are_units(labels: Sequence[str]) -> bool:
    given = [label for label in labels if label]
    return bool(given) and all(is_unit(label) or label[0] in "[(" for label in given)
