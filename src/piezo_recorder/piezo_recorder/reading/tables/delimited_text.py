# SPDX-License-Identifier: BSD-3-Clause
"""Tables in text files of any delimiter and decimal mark, read in chunks of bounded memory."""

import io
import math
import re
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from piezo_common.cancellation import check_cancelled
from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.reading.tables.cells import across_midnight, clock_seconds, is_time_of_day
from piezo_recorder.reading.tables.dialect import DELIMITERS, Dialect, dialect_of, is_comment
from piezo_recorder.reading.tables.labview_text import TIME, LabviewPreamble, labview_preamble
from piezo_recorder.reading.tables.table import Progress, Table
from piezo_recorder.reading.units import name_and_unit

HEAD_BYTES = 1 << 18
HEAD_LINES = 400
CHUNK_LINES = 100_000
LONGEST_LINE_BYTES = 1 << 22
"""Largest length of a line, which has room for tens of thousands of columns."""
UTF_16 = (b"\xff\xfe", b"\xfe\xff")

_NUMBER_AND_UNIT = re.compile(r"\s*[-+]?[\d.,]+(?:[eE][-+]?\d+)?\s*[^\W\d]{1,7}\s*")

Needed = Callable[[Table], Sequence[str]]
"""Returns the columns that a table must have in every row, given its labels."""


def read_text_table(path: Path, needed: Needed, progress: Progress) -> Table:
    """Read the table of a text file; a preamble, comments and empty lines are skipped.

    The needed columns are asked for with the table without rows. A column that is not needed and
    contains text is omitted, with a note. RecordingError, which names the line, is raised if there
    is no table, or a needed cell is not a finite number.
    """
    encoding, lines = _first_lines(path)
    found = _table_of(path, lines)
    if found is None:
        return _without_rows(path, lines, needed)
    dialect, labels, empty = found
    wanted = set(needed(empty))
    reading = _Reading(path, dialect, labels, wanted, encoding, progress)
    return replace(reading.table(), units=empty.units, scalars=empty.scalars)


def text_columns(path: Path) -> Table | None:
    """Return the table of a text file without its rows; None if there is none."""
    try:
        found = _table_of(path, _first_lines(path)[1])
    except (OSError, RecordingError):
        return None
    return found[2] if found else None


def _first_lines(path: Path) -> tuple[str, list[str]]:
    """Return the encoding and the first lines of a text file."""
    with open(path, "rb") as file:
        head = file.read(HEAD_BYTES)
    encoding = _encoding(path, head)
    text = head.decode(encoding, errors="replace").lstrip("\ufeff")
    if text.lstrip().startswith("{"):
        raise RecordingError(f"{path} is a JSON document, such as a model file, and no table: give "
                             "a recording, or a table of time, voltage and displacement")
    return encoding, text.splitlines()[:HEAD_LINES]


def _table_of(path: Path, lines: Sequence[str]) -> tuple[Dialect, list[str], Table] | None:
    """Return the dialect of the first lines, the labels, and the table without rows."""
    labview = labview_preamble(lines)
    dialect = dialect_of(lines, [labview.delimiter] if labview else DELIMITERS)
    if dialect is None:
        return None
    labels = _labels(path, dialect, lines)
    empty = Table(path, {label: np.empty(0) for label in labels if label},
                  _units(labels, dialect), header_line=dialect.header_line)
    if labview:
        _take_preamble(empty, labview)
    return dialect, labels, empty


def _units(labels: Sequence[str], dialect: Dialect) -> dict[str, str]:
    """Return the units that are not part of the labels of the columns."""
    clocks = {label: "s" for label, kind in zip(labels, dialect.kinds, strict=True)
              if kind == "clock"}
    numbered = {label: name_and_unit(written)[1]
                for label, written in zip(labels, dialect.header, strict=False)
                if label != written}
    return numbered | dict(zip(labels, dialect.units, strict=False)) | clocks


def _take_preamble(table: Table, labview: LabviewPreamble) -> None:
    """Add the units and the time of LabVIEW's preamble to a table without rows."""
    channels = [label for label in table.columns if label != TIME]
    table.units |= {label: unit for label, unit in zip(channels, labview.units, strict=False)
                    if unit}
    table.units[TIME] = "s"
    if not labview.has_time:
        table.columns.pop(TIME, None)
        if labview.period_s > 0.0:
            table.scalars["dt"] = labview.period_s


def _encoding(path: Path, head: bytes) -> str:
    if head.startswith(UTF_16):
        return "utf-16"
    if b"\0" in head:
        raise RecordingError(
            f"{path} is not plain text, nor another kind of file that is known: save it as "
            "comma-separated text, or as .mat, .h5, .npz, .tdms or .parquet")
    try:
        # The last character may be incomplete.
        head[:-4].decode("utf-8") if len(head) == HEAD_BYTES else head.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _without_rows(path: Path, lines: Sequence[str], needed: Needed) -> Table:
    """Return a table that consists of a header only, or raise if there is none."""
    for number, line in enumerate(lines):
        for delimiter in "\t;,":
            cells = line.split(delimiter)
            if len(cells) > 1 and all(_NUMBER_AND_UNIT.fullmatch(cell) for cell in cells):
                raise RecordingError(
                    f"{path}, row {number + 1}: '{cells[0].strip()[:40]}' is no number: write the "
                    "units into the header, not into the rows")
            labels = [label.strip(' "#%') for label in cells]
            if len(labels) < 3 or len(set(labels)) < len(labels):
                continue
            table = Table(path, {label: np.empty(0) for label in labels}, header_line=number)
            try:
                needed(table)
            except RecordingError:
                continue
            return table
    raise RecordingError(
        f"{path}, row 1: no table of numbers begins there or below: give rows of time, voltage and "
        "displacement, such as after the header time_s,voltage_v,displacement_um")


def _labels(path: Path, dialect: Dialect, lines: Sequence[str]) -> list[str]:
    """Return the labels of the columns; their numbers from 1 if there is no header.

    If a label occurs twice, the first one becomes LABEL.1.
    """
    if not dialect.header:
        above = dialect.first_line - 1
        names = dialect.split(lines[above]) if above >= 0 else []
        if above == 0 and len(names) > 2 and all(
                dialect.kind(name) == "text" for name in names):
            raise RecordingError(
                f"{path}, row {dialect.first_line + 1}: {dialect.cells} values where the header "
                f"names {len(names)} columns: complete the header or the rows"
                + (", or separate the cells by semicolons if commas are decimal marks"
                   if dialect.delimiter == "," else ""))
        return [str(number) if kind != "empty" or number < dialect.cells else ""
                for number, kind in enumerate(dialect.kinds, start=1)]
    twice = {label for label in dialect.header if label and dialect.header.count(label) > 1}
    return [f"{label}.{dialect.header[:column].count(label) + 1}" if label in twice else label
            for column, label in enumerate(dialect.header)]


class _WatchedBytes(io.BufferedReader):
    """Bytes to decode; reading stops if the work is cancelled, or a line does not end."""

    def __init__(self, raw: io.RawIOBase, path: Path) -> None:
        super().__init__(raw)
        self._path, self._line_bytes = path, 0

    def read1(self, size: int = -1, /) -> bytes:
        check_cancelled()
        part = super().read1(size)
        end = max(part.rfind(b"\n"), part.rfind(b"\r"))
        self._line_bytes = len(part) - end - 1 + (self._line_bytes if end < 0 else 0)
        if self._line_bytes > LONGEST_LINE_BYTES:
            raise RecordingError(f"{self._path} has a line of more than {LONGEST_LINE_BYTES} "
                                 "bytes: end each row, or copy the file again")
        return part


class _Reading:
    """One pass through a file."""

    def __init__(self, path: Path, dialect: Dialect, labels: list[str], needed: set[str],
                 encoding: str, progress: Progress):
        self._path, self._dialect, self._encoding = path, dialect, encoding
        self._progress, self._labels, self._needed = progress, labels, needed
        self._used = [column for column, label in enumerate(labels) if label in needed
                      or label and dialect.kinds[column] in ("number", "clock")]
        self._dropped: dict[str, str] = {}

    def table(self) -> Table:
        while True:
            self._skipped = [(0, self._dialect.first_line)]
            self._parts: list[int] = []
            self._times_of_day: set[str] = set()
            self._midnight_s: dict[str, float] = {}
            self._footer = self._grouped = ""
            try:
                chunks = list(self._chunks())
            except _UnusableColumn as found:
                self._used.remove(found.column)
                self._dropped[self._labels[found.column]] = found.what
                continue
            break
        columns = {self._labels[column]: np.concatenate([chunk[:, place] for chunk in chunks])
                   for place, column in enumerate(self._used)}
        notes = [f"{self._path}: the column '{label}' is skipped: {what}"
                 for label, what in self._dropped.items()]
        notes += [f"{self._path}: {note}" for note in (self._footer, self._grouped) if note]
        for label in self._times_of_day:
            columns[label] = across_midnight(columns[label])
        return Table(self._path, columns, parts=self._parts, skipped=self._skipped,
                     header_line=self._dialect.header_line, notes=notes)

    def _chunks(self) -> Iterator[np.ndarray]:
        footer = footer_lines(self._path, self._encoding, self._dialect)
        if footer:
            self._footer = (f"the file ends with {len(footer)} lines that are no rows; they are "
                            f"skipped, from '{footer[0][:40]}' on")
        with self._lines() as (stream, share):
            for _ in range(self._dialect.first_line):
                next(stream)
            rows, kept = 0, without_last(stream, len(footer)) if footer else iter(stream)
            while lines := list(islice(kept, CHUNK_LINES)):
                values = self._values(lines, rows)
                rows += len(values)
                yield values
                self._progress(f"read {self._path.name}", share())

    @contextmanager
    def _lines(self) -> Iterator[tuple[io.TextIOWrapper, Callable[[], float]]]:
        size = max(self._path.stat().st_size, 1)
        with _WatchedBytes(open(self._path, "rb", buffering=0), self._path) as raw:
            stream = io.TextIOWrapper(raw, encoding=self._encoding, errors="replace")
            yield stream, lambda: min(raw.tell() / size, 1.0)

    def _values(self, lines: list[str], rows: int) -> np.ndarray:
        """Return the rows in some lines, shape (n, used columns)."""
        values = self._parsed(lines)
        return self._slowly(lines, rows) if values is None else values

    def _parsed(self, lines: list[str]) -> np.ndarray | None:
        """Return the numbers that NumPy parses; None unless all needed cells are finite."""
        if not lines or "clock" in self._dialect.kinds:
            return None
        if self._dialect.decimal == ",":
            if any("." in line for line in lines):
                return None  # it may be a thousands separator
            lines = [line.replace(",", ".") for line in lines]
        every = len(self._used) == len(self._labels)
        if not every and any(map(is_comment, lines)):
            return None  # if the mark is only in columns that are not read
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "loadtxt: input contained no data")
                values = np.loadtxt(lines, delimiter=self._dialect.delimiter, ndmin=2,
                                    comments=None, quotechar='"',
                                    usecols=None if every else self._used)
        except ValueError:
            return None
        if values.shape != (len(lines), len(self._used)) or not self._finite(values).all():
            return None
        # If only some columns are read, NumPy accepts rows of another length.
        return values if every or self._even(lines) else None

    def _even(self, lines: list[str]) -> bool:
        delimiter = self._dialect.delimiter
        if delimiter is None or any('"' in line for line in lines[:1]):
            return all(len(self._dialect.split(line)) == self._dialect.cells for line in lines)
        return all(line.count(delimiter) == self._dialect.cells - 1 for line in lines)

    def _finite(self, values: np.ndarray) -> np.ndarray:
        needed = [self._labels[column] in self._needed for column in self._used]
        return np.isfinite(values[:, needed])

    def _slowly(self, lines: list[str], rows: int) -> np.ndarray:
        """Return the rows in lines with comments or a repeated header between them."""
        dialect = self._dialect
        values: list[list[float]] = []
        for line in lines:
            row = rows + len(values)
            cells = [] if is_comment(line) else dialect.split(line)
            if not cells or self._is_header(cells):
                if cells and row:
                    self._parts.append(row)
                self._skipped.append((row, self._skipped[-1][1] + 1))
                continue
            place = f"{self._path}, row {row + self._skipped[-1][1] + 1}"
            if len(cells) != dialect.cells:
                raise RecordingError(
                    f"{place}: {len(cells)} values where the header names {dialect.cells} columns: "
                    "complete the row or remove it")
            values.append([self._number(cells[column], column, place) for column in self._used])
        return np.array(values, dtype=float).reshape(-1, len(self._used))

    def _is_header(self, cells: list[str]) -> bool:
        """Return whether a line repeats the header, or the units below it."""
        labels = self._dialect.header
        return bool(labels) and (cells == list(labels) or cells == list(self._dialect.units))

    def _number(self, cell: str, column: int, place: str) -> float:
        dialect, label = self._dialect, self._labels[column]
        kind = dialect.kind(cell)
        if kind == "empty":
            return math.nan
        value = self._clock(cell, label) if kind == "clock" else dialect.number(cell)
        if math.isfinite(value):
            if not self._grouped and dialect.is_grouped(cell):
                self._grouped = f"'{cell}' in {place.rsplit(', ', 1)[1]} is read as {value:g}"
            return value
        if label in self._needed:
            raise RecordingError(f"{place}: {label} is '{cell[:40]}', no finite number: mend the "
                                 "value or cut the file there")
        if kind == "text":
            raise _UnusableColumn(column, f"it is '{cell[:40]}' in {place.rsplit(', ', 1)[1]}")
        return value

    def _clock(self, cell: str, label: str) -> float:
        """Return a time in seconds since the midnight before the first row."""
        if is_time_of_day(cell):
            self._times_of_day.add(label)
        midnight_s, seconds = clock_seconds(cell)
        return midnight_s - self._midnight_s.setdefault(label, midnight_s) + seconds


class _UnusableColumn(Exception):
    """A column that is not needed contains text."""

    def __init__(self, column: int, what: str):
        super().__init__(what)
        self.column, self.what = column, what


TAIL_BYTES = 1 << 14
MOST_LINES = 40
"""Largest number of lines; a longer end without rows is damage, and reported at its beginning."""


def footer_lines(path: Path, encoding: str, dialect: Dialect) -> list[str]:
    """Return the lines at the end of a file that begin with text, unlike the rows.

    Comments and empty lines between and below them are included. There are none if the last line
    with any content is a row, or the end without rows is long.
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
