# SPDX-License-Identifier: BSD-3-Clause
"""Reader of CSV files, which tells the row that is wrong."""

import csv
import math
import warnings
from pathlib import Path

import numpy as np

from piezo_recorder.reading.recording import Recording, RecordingError
from piezo_recorder.sample_block import Flag

CSV_COLUMNS = ("time_s", "voltage_v", "displacement_um")
# Of a period: what rounding of the times may come to.
TIME_TOLERANCE = 0.1


def read_csv(path: Path) -> Recording:
    """Read a CSV file with the columns ``CSV_COLUMNS`` and any further ones.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Recording

    Raises
    ------
    RecordingError
        If a column, a row or the sample period is not as it should be; names the row.
    """
    try:
        return _read_table(path)
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(
            f"{path} is not plain text ({error}): save it as comma-separated text.") from None


def _read_table(path: Path) -> Recording:
    header = _header(path)
    values = _values(path, len(header))
    if values is None:
        raise RecordingError(_first_fault(path, header))
    if len(values) < 2:
        raise RecordingError(f"{path} has fewer than two rows of samples: give more of them.")
    columns = dict(zip(header, np.ascontiguousarray(values.T), strict=True))
    period_s = _uniform_period_s(path, columns.pop("time_s"))
    samples = len(values)
    return Recording(
        path=str(path),
        sample_rate_hz=1 / period_s,
        sample_index=np.arange(samples),
        sample_periods_s=np.full(samples, period_s),
        voltage_v=columns.pop("voltage_v"),
        displacement_um=columns.pop("displacement_um"),
        flags=np.full(samples, Flag.PLAYING, dtype=np.uint32),
        columns=columns)


def _header(path: Path) -> list[str]:
    with open(path, newline="", encoding="utf-8-sig") as stream:
        header = [name.strip() for name in next(csv.reader(stream), [])]
    for name in CSV_COLUMNS:
        if name not in header:
            raise RecordingError(
                f"{path}, row 1: the column {name} is missing: "
                f"begin the file with the header {','.join(CSV_COLUMNS)}.")
    for name in header:
        if header.count(name) > 1:
            raise RecordingError(
                f"{path}, row 1: the column '{name}' is there twice: rename one of them.")
    return header


def _values(path: Path, columns: int) -> np.ndarray | None:
    """Read the table below the header; None unless all its cells are finite numbers."""
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "loadtxt: input contained no data")
            values = np.loadtxt(
                path, delimiter=",", skiprows=1, ndmin=2, comments=None, quotechar='"',
                encoding="utf-8-sig")
    except ValueError:
        return None
    if values.size == 0:
        return values.reshape(0, columns)
    return values if values.shape[1] == columns and np.all(np.isfinite(values)) else None


def _first_fault(path: Path, header: list[str]) -> str:
    """Say which row keeps the file from being a table of finite numbers."""
    with open(path, newline="", encoding="utf-8-sig") as stream:
        rows = csv.reader(stream)
        next(rows)
        for row in rows:
            if row and len(row) != len(header):
                return (f"{path}, row {rows.line_num}: {len(row)} values where the header names "
                        f"{len(header)} columns: complete the row or remove it.")
            for name, cell in zip(header, row, strict=False):
                if not _is_finite(cell):
                    return (f"{path}, row {rows.line_num}: {name} is '{cell}', no finite number: "
                            "mend the value or cut the file there.")
    return f"{path} is no table of numbers: save it as plain comma-separated text."


def _is_finite(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def _uniform_period_s(path: Path, time_s: np.ndarray) -> float:
    period_s = (time_s[-1] - time_s[0]) / (len(time_s) - 1)
    deviation_s = time_s - time_s[0] - period_s * np.arange(len(time_s))
    if period_s > 0 and np.all(np.abs(deviation_s) <= TIME_TOLERANCE * period_s):
        return period_s
    steps_s = np.diff(time_s)
    usual_s = np.median(steps_s)
    worst = int(np.argmax(np.abs(steps_s - usual_s)))
    raise RecordingError(
        f"{path}, row {worst + 3}: time_s steps by {steps_s[worst]:g} s where {usual_s:g} s is "
        "usual: resample the data to one sample period.")
