# SPDX-License-Identifier: BSD-3-Clause
"""Rewrite any recording in the format of this suite, or as CSV: ``convert FILE NEW``."""

import argparse
import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from piezo_common.command_line import print_next
from piezo_recorder.reading.data_options import read_all_given
from piezo_recorder.reading.detected import is_detected, marks_in, signals_in
from piezo_recorder.reading.reader import origin_of
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import TYPE_NAME
from piezo_recorder.writing.message_definition import installed_definition
from piezo_recorder.writing.writer import RecordingWriter

BLOCK_SAMPLES = 4000
ROWS_AT_ONCE = 50_000
TOPIC = "/stage/samples"


def write_csv(recording: Recording, path: Path) -> None:
    """Write a recording as a new CSV file with the columns of this suite and its further ones.

    Numbers have as many digits as are needed to read them back exactly; times have 12 digits.
    FileExistsError is raised if the file exists already.
    """
    columns = [*recording.signals.values(), *recording.columns.values()]
    labels = ["time_s", *recording.signals,
              *(f'"{name}"' if "," in name else name for name in recording.columns)]
    time_s = recording.time_s
    with open(path, "x", encoding="utf-8") as file:
        file.write(",".join(labels) + "\n")
        for start in range(0, len(time_s), ROWS_AT_ONCE):
            rows = slice(start, start + ROWS_AT_ONCE)
            values = np.column_stack([np.asarray(column[rows], float) for column in columns])
            file.writelines(f"{time:.12g},{','.join(map(repr, row))}\n" for time, row in zip(
                time_s[rows].tolist(), values.tolist(), strict=True))


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording as a new rosbag2 directory of sample blocks, with its gaps.

    Of its further columns only marks and signals are written. FileExistsError is raised if the
    directory exists already.
    """
    definition = installed_definition(TYPE_NAME)
    typestore = get_typestore(Stores.EMPTY)
    typestore.register(get_types_from_msg(definition.text, TYPE_NAME))
    types = typestore.types
    marks, signals = marks_in(recording.columns), signals_in(recording.columns)
    signal = np.array([*signals.values()], dtype=float).T
    stamp, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    with RecordingWriter(path, recording.sample_rate_hz) as writer:
        writer.attach("conversion.json", json.dumps({
            "source": recording.path, "sha256": origin_of(recording)["sha256"],
            "recording": recording.title, "notes": recording.notes}, indent=1).encode())
        channel = writer.add_topic(TOPIC, definition)
        for tick, rows in enumerate(_blocks(recording), start=1):
            first = int(recording.sample_index[rows][0])
            time_ns = round(1e9 * first / recording.sample_rate_hz)
            block = types[TYPE_NAME](
                header=header(stamp(*divmod(time_ns, 1_000_000_000)), "stage"),
                first_sample=first, sample_period_s=float(recording.sample_periods_s[rows][0]),
                tick=tick, voltage_v=np.ravel(recording.voltage_v[rows]).astype(float),
                displacement_um=np.ravel(recording.displacement_um[rows]).astype(float),
                flags=int(recording.flags[rows][0]), missed_feedback=0, axes=list(recording.axes),
                marks=marks[rows], signals=list(signals), signal=np.ravel(signal[rows]))
            writer.write(channel, bytes(typestore.serialize_cdr(block, TYPE_NAME)), time_ns)


def _blocks(recording: Recording) -> Iterator[slice]:
    """Yield the rows of each block; gaps and changes of period or flags are only between blocks."""
    strides = np.round(recording.sample_periods_s * recording.sample_rate_hz).astype(np.int64)
    breaks = ((np.diff(recording.sample_index) != strides[:-1]) | (np.diff(strides) != 0)
              | (np.diff(recording.flags.astype(np.int64)) != 0))
    edges = [0, *(np.flatnonzero(breaks) + 1).tolist(), len(strides)]
    for start, end in zip(edges[:-1], edges[1:], strict=True):
        for first in range(start, end, BLOCK_SAMPLES):
            yield slice(first, min(first + BLOCK_SAMPLES, end))


def convert_file(options: argparse.Namespace) -> None:
    """Write the recordings of a file as new ones."""
    output: Path = options.output
    found = read_all_given(options.recording, options, several_axes=True)
    for recording in found:
        # Titles come from the file and may contain any character.
        title = re.sub(r"[^\w-]+", "_", recording.title)
        name = f"{output.stem}_{title}" if len(found) > 1 else output.stem
        path = output.with_name(name + output.suffix)
        is_csv = path.suffix.lower() == ".csv"
        (write_csv if is_csv else write_recording)(recording, path)
        print(f"{len(recording.voltage_v)} samples written to {path}")
        left_out = [] if is_csv else [
            label for label in recording.columns if not is_detected(label)]
        if left_out:
            print(f"not written: {', '.join(left_out)}, for which only a CSV has room")
        print_next(options, "piezo_identification", "check", "--data", path)
