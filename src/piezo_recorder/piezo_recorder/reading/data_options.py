# SPDX-License-Identifier: BSD-3-Clause
"""How the commands read their data: columns, notes, progress."""

import argparse
from os import PathLike
from pathlib import Path

from piezo_common.progress_line import ProgressLine
from piezo_recorder.reading.columns import parse_columns
from piezo_recorder.reading.reader import only_recording, read_recordings
from piezo_recorder.reading.recording import Recording
from piezo_recorder.reading.tables.table import no_progress

WORTH_A_LINE_BYTES = 30_000_000
"""Size from which on progress is printed; smaller files are read in about a second."""


def read_all_given(path: str | PathLike[str], options: argparse.Namespace,
                   several_axes: bool = False) -> list[Recording]:
    """Read all recordings of a file, and print the notes on them.

    The options are those of a parser with `add_columns_option`. RecordingError is raised if the
    file cannot be read.
    """
    line = ProgressLine()
    found = read_recordings(
        path, columns=parse_columns(options.columns),
        progress=line.show if _size(Path(path)) > WORTH_A_LINE_BYTES else no_progress,
        several_axes=several_axes)
    line.clear()
    for note in dict.fromkeys(note for recording in found for note in recording.notes):
        print(note)
    return found


def columns_given(options: argparse.Namespace) -> list[str]:
    """Return the option ``--columns`` as it was given, for a further command on the same data."""
    return ["--columns", *options.columns] if options.columns else []


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0


def read_given(path: str | PathLike[str], options: argparse.Namespace) -> Recording:
    """Read the one recording of a file; see `read_all_given`."""
    return only_recording(path, read_all_given(path, options))
