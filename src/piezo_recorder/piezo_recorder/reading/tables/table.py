# SPDX-License-Identifier: BSD-3-Clause
"""A table of samples as written by some program: labelled columns, not yet interpreted."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

Progress = Callable[[str, float], object]
"""Called with the name of the present step and the fraction done (0 to 1)."""


def no_progress(what: str, fraction: float) -> None:
    """Do not report progress."""


@dataclass
class Table:
    """Columns of equal length with the labels of the file."""

    path: Path
    """Path of the file that was read."""
    columns: dict[str, np.ndarray]
    """By label, such as ``Time [s]``, in the order of the file, (N,). Times of the day and dates
    are in seconds."""
    units: dict[str, str] = field(default_factory=dict)
    """Units that the file keeps separate from the labels, by label."""
    scalars: dict[str, float] = field(default_factory=dict)
    """Single numbers in addition to the columns, such as a sample rate."""
    title: str = ""
    """Name of the group that holds the table; empty if there is none."""
    parts: list[int] = field(default_factory=list)
    """Rows at which the file itself begins another recording, without the first row."""
    skipped: list[tuple[int, int]] = field(default_factory=lambda: [(0, 0)])
    """Row of the table, and number of lines of the file before it that are not rows."""
    header_line: int = -1
    """Line of the file with the labels, from 0; -1 if there is none."""
    notes: list[str] = field(default_factory=list)
    """What was omitted, for users."""
    left_out: dict[str, int] = field(default_factory=dict)
    """Columns of the file of another length than these, and that length."""

    @property
    def header_place(self) -> str:
        """Return the position of the labels of the columns, for a message."""
        if self.header_line >= 0:
            return f"{self.path}, row {self.header_line + 1}"
        return f"{self.path}, {self.title}" if self.title else str(self.path)

    @property
    def rows(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.columns.values()), ()))

    def place(self, row: int) -> str:
        """Return the position of a row for a message: its line in the file, counted from 1."""
        found = self.skipped[bisect_right(self.skipped, (row, 1 << 62)) - 1]
        of_group = f" of {self.title}" if self.title else ""
        return f"{self.path}, row {row + found[1] + 1}{of_group}"

    def cut(self, rows: slice, title: str) -> "Table":
        """Return some consecutive rows as a separate table."""
        first = rows.start or 0
        skipped = [(max(row - first, 0), lines + first) for row, lines in self.skipped]
        return Table(self.path, {name: values[rows] for name, values in self.columns.items()},
                     self.units, self.scalars, title, [], skipped, self.header_line, self.notes)


def array_columns(name: str, values: Any) -> dict[str, np.ndarray]:
    """Return the columns of a numeric array; empty if it is not such an array.

    A two-dimensional array has columns NAME.1, NAME.2, ...; a structured one NAME.FIELD.
    """
    array = np.asarray(values)
    if array.dtype.names:
        flat = np.squeeze(array)
        return {label: column for part in array.dtype.names
                for label, column in array_columns(joined(name, part), flat[part]).items()}
    if array.dtype.kind in "mM":
        array = seconds(array)
    if array.dtype.kind not in "iufb" or array.size < 2:
        return {}
    array = np.squeeze(array)
    if array.ndim == 1:
        return {name: array.astype(float)}
    if array.ndim != 2:
        return {}
    if array.shape[0] < array.shape[1]:
        array = array.T
    return {joined(name, str(number)): np.array(column, dtype=float)
            for number, column in enumerate(array.T, start=1)}


def joined(group: str, name: str) -> str:
    """Return the name of a member of a group."""
    return f"{group}.{name}" if group else name


def seconds(times: np.ndarray) -> np.ndarray:
    """Return dates or spans of NumPy as seconds since the first one."""
    spans = times - times.flat[0] if times.dtype.kind == "M" else times
    return spans / np.timedelta64(1, "s")


def equal_length(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the columns of the most common length; the larger one of equally common lengths."""
    lengths = [len(values) for values in columns.values()]
    if not lengths:
        return {}
    rows = max(set(lengths), key=lambda length: (lengths.count(length), length))
    return {name: values for name, values in columns.items() if len(values) == rows}


def listing(names: Sequence[str], most: int = 12) -> str:
    """Return names for a message; if there are many, only the first of them."""
    shown = ", ".join(f"'{name}'" for name in names[:most])
    return f"{shown} and {len(names) - most} more" if len(names) > most else shown or "none"
