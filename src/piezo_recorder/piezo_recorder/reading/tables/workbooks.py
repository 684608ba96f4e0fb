# SPDX-License-Identifier: BSD-3-Clause
"""Sheets of spreadsheet programs: .xlsx."""

import zipfile
from collections.abc import Iterable, Iterator
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_recorder.reading.tables.array_files import Group, damage_reported, read_npz, tables_of
from piezo_recorder.reading.tables.cells import across_midnight, clock_seconds
from piezo_recorder.reading.tables.libraries import library
from piezo_recorder.reading.tables.table import Progress, Table

WORKBOOK = "[Content_Types].xml"
"""File that every workbook contains."""

Clock = datetime | time | timedelta
"""Types of a cell that is formatted as a time, which openpyxl rounds to milliseconds."""


def read_zip(path: Path, progress: Progress) -> list[Table]:
    """Read a workbook, or else the arrays of an .npz."""
    with damage_reported(path, "archive"), zipfile.ZipFile(path) as archive:
        is_workbook = WORKBOOK in archive.namelist()
    return (read_workbook if is_workbook else read_npz)(path, progress)


def read_workbook(path: Path, progress: Progress) -> list[Table]:
    """Read the sheets of a workbook; each is a table below its last row of text."""
    openpyxl = library("openpyxl", path)
    groups = []
    with damage_reported(path, "workbook"):
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            for number, sheet in enumerate(book.worksheets, start=1):
                groups.append(_group(sheet.title, sheet.iter_rows(values_only=True)))
                progress(f"read {path.name}", number / len(book.worksheets))
        finally:
            book.close()
    return tables_of(path, groups)


def _group(title: str, rows: Iterable[tuple[Any, ...]]) -> Group:
    labels: tuple[Any, ...] = ()
    numbers: list[tuple[Any, ...]] = []
    for row in rows:
        if any(isinstance(cell, int | float) for cell in row):
            numbers.append(row)
        elif any(cell is not None for cell in row) and not numbers:
            labels = row
    group = Group(title)
    for column in _columns(labels, numbers):
        group.take(*column)
    return group


def _columns(labels: tuple[Any, ...], rows: list[tuple[Any, ...]],
             ) -> Iterator[tuple[str, FloatArray, str]]:
    """Yield label, values and unit of each column of numbers or times; other cells are NaN."""
    for column in range(max(map(len, rows), default=0)):
        cells = [row[column] if column < len(row) else None for row in rows]
        are_times = any(isinstance(cell, Clock) for cell in cells)
        values = _seconds(cells) if are_times else np.array(
            [cell if isinstance(cell, int | float) else np.nan for cell in cells], dtype=float)
        label = labels[column] if column < len(labels) else None
        if np.isfinite(values).any():
            yield str(label if label is not None else column + 1), values, "s" * are_times


def _seconds(cells: list[Any]) -> FloatArray:
    """Return times in seconds, and dates in seconds since the midnight before the first."""
    found = np.array([
        (0.0, cell.total_seconds()) if isinstance(cell, timedelta)
        else clock_seconds(str(cell)) for cell in cells])
    midnights_s = found[:, 0]
    seconds = midnights_s - midnights_s[np.isfinite(midnights_s)][0] + found[:, 1]
    return across_midnight(seconds) if any(isinstance(cell, time) for cell in cells) else seconds
