# SPDX-License-Identifier: BSD-3-Clause
"""Columns of measuring programs and data frames: TDMS, Parquet and Arrow."""

import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezo_recorder.reading.tables.array_files import Group, damage_reported, tables_of
from piezo_recorder.reading.tables.libraries import library
from piezo_recorder.reading.tables.table import Progress, Table

WAVEFORM_TIME = "time [s]"
"""Label of the time that follows from the increment of a TDMS waveform."""

MOST_OF_WARNING = 120
"""Largest length of a warning (characters), as the library quotes unreadable bytes."""


def read_tdms(path: Path, progress: Progress) -> list[Table]:
    """Read the channels of a TDMS file; each of its groups is a table."""
    nptdms = library("nptdms", path)
    groups = []
    with (damage_reported(path, "TDMS file"), _warnings_of_tdms() as warned,
          nptdms.TdmsFile.open(path) as file):
        channels = sum(len(group.channels()) for group in file.groups())
        for found in file.groups():
            group = Group(found.name)
            groups.append(group)
            for channel in found.channels():
                _take_channel(group, channel)
                progress(f"read {path.name}", len(group.columns) / max(channels, 1))
        tables = [table for table in tables_of(path, groups) if table.rows]
    for table in tables:
        table.notes += [f"{path} is damaged or cut short ({text}): the rest of it is read"
                        for text in dict.fromkeys(warned)]
    return tables


@contextmanager
def _warnings_of_tdms() -> Iterator[list[str]]:
    """Collect the warnings of the library on a file that it can read in part."""
    from nptdms.log import log_manager

    found: list[str] = []

    def collect(record: logging.LogRecord) -> bool:
        found.append(" ".join(record.getMessage().split())[:MOST_OF_WARNING])
        return False

    log_manager.console_handler.addFilter(collect)
    try:
        yield found
    finally:
        log_manager.console_handler.removeFilter(collect)


def _take_channel(group: Group, channel: Any) -> None:
    values = channel[:]
    if values.dtype.kind not in "iufbM" or not len(values):
        return
    group.take(channel.name, values, str(channel.properties.get("unit_string", "")))
    increment_s = channel.properties.get("wf_increment")
    if increment_s and WAVEFORM_TIME not in group.columns:
        start_s = float(channel.properties.get("wf_start_offset", 0.0))
        group.take(WAVEFORM_TIME, start_s + float(increment_s) * np.arange(len(values)))


def read_parquet(path: Path, progress: Progress) -> list[Table]:
    """Read the columns of a Parquet file, batch by batch."""
    parquet = library("pyarrow.parquet", path)
    with damage_reported(path, "Parquet file"), parquet.ParquetFile(path) as file:
        return _tables(path, file.schema_arrow, file.iter_batches(), file.metadata.num_rows,
                       progress)


def read_arrow(path: Path, progress: Progress) -> list[Table]:
    """Read the columns of an Arrow (Feather) file, batch by batch."""
    ipc = library("pyarrow.ipc", path)
    with damage_reported(path, "Arrow file"), ipc.open_file(str(path)) as file:
        count = file.num_record_batches
        batches = (file.get_batch(number) for number in range(count))
        return _tables(path, file.schema, batches, 0, progress)


def _tables(path: Path, schema: Any, batches: Iterable[Any], rows: int,
            progress: Progress) -> list[Table]:
    chunks: dict[str, list[np.ndarray]] = {}
    read = 0
    for batch in batches:
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            values = column.to_numpy(zero_copy_only=False)
            if values.dtype.kind in "iufbmM":
                chunks.setdefault(name, []).append(
                    values if values.dtype.kind in "mM" else values.astype(float))
        read += batch.num_rows
        progress(f"read {path.name}", min(read / rows, 1.0) if rows else 0.0)
    group = Group("")
    for name, parts in chunks.items():
        metadata = schema.field(name).metadata or {}
        group.take(name, np.concatenate(parts), metadata.get(b"unit", b"").decode())
    return tables_of(path, [group])
