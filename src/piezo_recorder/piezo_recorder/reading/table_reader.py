# SPDX-License-Identifier: BSD-3-Clause
"""Recordings in the files of other programs: one reader for all kinds of tables."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from piezo_recorder.reading.columns import GUESSED, ColumnsDocument, columns_for
from piezo_recorder.reading.plausibility import implausible
from piezo_recorder.reading.recording import Recording, RecordingError
from piezo_recorder.reading.signal_columns import (
    SignalSource,
    described_label,
    needed_columns,
    rate_hz_of,
)
from piezo_recorder.reading.tables.file_kinds import read_tables
from piezo_recorder.reading.tables.table import Progress, Table, no_progress
from piezo_recorder.reading.time_axis import TimeAxis, repeated_rows, restarts, time_axis
from piezo_recorder.sample_block import Flag

HOLDING = 0.5
"""Part of the voltages that equal the one before, above which a voltage is held between rows."""

MOST_RECORDINGS = 1000

MOST_MISSING = 0.05
"""Part of the rows that may lack a value; with more, the column is probably the wrong one."""

SCPI_MISSING = 9.91e37
"""Value that SCPI instruments send for "not a number"."""


def read_table_recordings(path: Path, columns: ColumnsDocument = GUESSED,
                          progress: Progress = no_progress) -> list[Recording]:
    """Read all recordings of a file of another program.

    `columns_for` adds the description of a YAML file next to the data. RecordingError, of one line,
    is raised if the file, a column, a row or the sample period is invalid.
    """
    described = columns_for(path, columns)
    tables = read_tables(path, lambda table: _needed_labels(table, described), progress)
    if not tables:
        raise RecordingError(f"{path} holds no columns of numbers: save time, voltage and "
                             "displacement as arrays of one length")
    return recordings_of(tables, described)


def recordings_of(tables: Sequence[Table], described: ColumnsDocument) -> list[Recording]:
    """Return the recordings in tables: the groups of a file, then the whole file; at least one.

    RecordingError is raised if a table is invalid, see `read_table_recordings`.
    """
    *groups, whole = tables
    usable = [group for group in groups if _sources(group, described)]
    parts = [part for table in usable or [whole] for part in _parts(table, described)]
    only = described.recording.only if described.recording else ""
    chosen = [part for part in parts if only in ("", part.title)]
    if not chosen:
        names = ", ".join(part.title or "1" for part in parts[:12])
        raise RecordingError(f"{whole.path} has no recording '{only}': give one of {names}")
    return [_recording(part, described, several=len(parts) > 1) for part in chosen]


def _needed_labels(table: Table, described: ColumnsDocument) -> list[str]:
    labels = [source.label for source in needed_columns(table, described).values()]
    if described.recording and described.recording.column:
        labels.append(described_label(table, "recording", described.recording.column))
    return labels


def _sources(table: Table, described: ColumnsDocument) -> dict[str, SignalSource]:
    """Return the columns of the signals of a group; empty if it lacks one of them."""
    try:
        return needed_columns(table, described)
    except RecordingError:
        return {}


def _parts(table: Table, described: ColumnsDocument) -> list[Table]:
    """Split a table at the rows where another recording begins."""
    sources = needed_columns(table, described)
    if table.rows < 2:
        return [table]
    titles: list[str] = []
    if described.recording and described.recording.column:
        number = table.columns[described_label(table, "recording", described.recording.column)]
        begins = (np.flatnonzero(np.diff(number) != 0.0) + 1).tolist()
        titles = [f"{number[row]:g}" for row in [0, *begins]]
    else:
        time = sources.get("time")
        begins = table.parts or (restarts(table.columns[time.label] * time.scale) if time else [])
    begins = [row for row in begins if 0 < row < table.rows]
    if not begins:
        return [table]
    if len(begins) == table.rows - 1 and not titles:
        raise RecordingError(f"{table.place(1)}: the time falls from row to row: sort the rows by "
                             "their time")
    if len(begins) >= MOST_RECORDINGS:
        raise RecordingError(f"{table.place(begins[0])}: {len(begins) + 1} recordings begin there "
                             "and below: give fewer than 1000 in one file")
    titles = titles or [str(number) for number in range(1, len(begins) + 2)]
    prefix = f"{table.title}." if table.title else ""
    return [table.cut(slice(start, end), prefix + title) for start, end, title in zip(
        [0, *begins], [*begins, table.rows], titles, strict=True)]


def _recording(table: Table, described: ColumnsDocument, several: bool) -> Recording:
    """Return the samples of one table."""
    if table.rows < 2:
        of_part = f" of recording {table.title}" if table.title else ""
        raise RecordingError(
            f"{table.path} has fewer than two rows of samples{of_part}: give more of them")
    sources = needed_columns(table, described)
    signals = {signal: _in_unit(table, source) for signal, source in sources.items()}
    rows, row_notes = _rows_of_samples(table, sources, signals)
    axis = _axis(table, sources, signals, rows, described)
    used = {source.label for source in sources.values()}
    further = {label: values[rows] for label, values in table.columns.items()
               if label not in used}
    voltage_v, displacement_um = signals["voltage"][rows], signals["displacement"][rows]
    if axis.at_rows is not None:
        displacement_um = _at_rows(displacement_um, axis.at_rows)
        holds = np.mean(np.diff(voltage_v) == 0.0) > HOLDING
        voltage_v = voltage_v[axis.at_rows.astype(int)] if holds else _at_rows(
            voltage_v, axis.at_rows)
        further = {label: _at_rows(values, axis.at_rows) for label, values in further.items()}
    samples = len(voltage_v)
    recording = Recording(
        path=str(table.path), sample_rate_hz=1.0 / axis.period_s, sample_index=axis.sample_index,
        sample_periods_s=np.full(samples, axis.period_s), voltage_v=voltage_v,
        displacement_um=displacement_um, flags=np.full(samples, Flag.PLAYING, dtype=np.uint32),
        gaps=_gaps(axis.sample_index), columns=further, jitter_s=axis.jitter_s,
        title=table.title if several else "")
    where = f"{table.path}: " + (f"recording {table.title}: " if several else "")
    notes = [*table.notes, *(source.note for source in sources.values() if source.note),
             *(where + note for note in (*row_notes, *axis.notes, *implausible(recording)))]
    return replace(recording, notes=notes)


def _axis(table: Table, sources: dict[str, SignalSource], signals: dict[str, np.ndarray],
          rows: np.ndarray, described: ColumnsDocument) -> TimeAxis:
    def place(row: int) -> str:
        return table.place(int(rows[row]))

    if "time" in sources:
        return time_axis(signals["time"][rows], place, sources["time"].label)
    rate_hz = rate_hz_of(table, described)
    assert rate_hz is not None  # otherwise a column of time is required
    axis = time_axis(rows / rate_hz, place, "the number of the row")
    return replace(axis, period_s=1.0 / rate_hz, notes=[
        f"there is no time; {rate_hz:g} rows a second are assumed as given", *axis.notes])


def _in_unit(table: Table, source: SignalSource) -> np.ndarray:
    """Return a signal in s, V or um, with NaN where the file has no value."""
    values = table.columns[source.label]
    values = np.where(np.abs(values) == SCPI_MISSING, np.nan, values)
    return values if source.scale == 1.0 else values * source.scale


def _rows_of_samples(table: Table, sources: dict[str, SignalSource],
                     signals: dict[str, np.ndarray]) -> tuple[np.ndarray, list[str]]:
    """Return the rows with all signals, each of them once, and notes on the others."""
    good = np.ones(table.rows, dtype=bool)
    for values in signals.values():
        good &= np.isfinite(values)
    missing = np.flatnonzero(~good)
    infinite = any(np.isinf(values).any() for values in signals.values())
    if missing.size and (infinite or missing.size > MOST_MISSING * table.rows):
        row = int(missing[0])
        label, value = next((sources[signal].label, values[row])
                            for signal, values in signals.items() if not np.isfinite(values[row]))
        what = (f"is missing, as values are in {missing.size} of {table.rows} rows"
                if np.isnan(value) else f"is '{value:g}', no finite number")
        raise RecordingError(
            f"{table.place(row)}: {label} {what}: mend the value or cut the file there")
    notes = []
    if missing.size:
        notes.append(f"{missing.size} rows have no value, the first of them "
                     f"{table.place(int(missing[0])).rpartition(', ')[2]}: they are skipped")
    rows = np.flatnonzero(good)
    if "time" in signals and rows.size:
        others = [values[rows] for signal, values in signals.items() if signal != "time"]
        twice = repeated_rows(signals["time"][rows], others)
        if twice.any():
            notes.append(f"{int(twice.sum())} rows are there twice, the first of them "
                         f"{table.place(int(rows[twice][0])).rpartition(', ')[2]}: one of each is "
                         "skipped")
        rows = rows[~twice]
    return rows, notes


def _at_rows(values: np.ndarray, at_rows: np.ndarray) -> np.ndarray:
    """Return values between rows by linear interpolation."""
    return np.interp(at_rows, np.arange(len(values)), values)


def _gaps(sample_index: np.ndarray) -> list[tuple[int, int]]:
    missing = np.diff(sample_index) - 1
    return [(int(sample_index[row]) + 1, int(missing[row])) for row in np.flatnonzero(missing)]
