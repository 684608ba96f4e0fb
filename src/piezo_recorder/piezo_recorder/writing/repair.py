# SPDX-License-Identifier: BSD-3-Clause
"""Make a complete recording from that of a killed recorder: ``repair RECORDING NEW``."""

import argparse
from os import PathLike
from pathlib import Path

import mcap.records

from piezo_common.command_line import print_next
from piezo_recorder.reading.reader import RecordReader, data_files, was_cut_short
from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.writing.message_definition import MessageDefinition
from piezo_recorder.writing.quality_profiles import profiles_from_text
from piezo_recorder.writing.writer import STAGE_METADATA, RecordingWriter


def repair(path: str | PathLike[str], output: str | PathLike[str]) -> int:
    """Copy every complete message into a new recording with an index; return their number.

    Parameters
    ----------
    path : str or Path
        Directory of a recording, or an MCAP file.
    output : str or Path
        Directory to create.

    Raises
    ------
    RecordingError
        If the recording is not an MCAP file, or is damaged rather than cut short.
    FileExistsError
        If ``output`` exists already.
    """
    files = data_files(Path(path))
    for file in files:
        if file.suffix.lower() == ".csv":
            raise RecordingError(f"{file} is no MCAP file: a CSV needs no index.")
    with _Copy(output) as copy:
        for file in files:
            copy.take(file)
    return copy.writer.message_count


class _Copy:
    """The new recording."""

    def __init__(self, output: str | PathLike[str]):
        self.writer = RecordingWriter(output)
        self._topics: dict[str, int] = {}
        # By their numbers in the file that is read, which start again in the next file.
        self._schemas: dict[int, mcap.records.Schema] = {}
        self._channels: dict[int, int] = {}

    def __enter__(self) -> "_Copy":
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def take(self, file: Path) -> None:
        self._schemas.clear()
        self._channels.clear()
        with open(file, "rb") as stream:
            try:
                for record in RecordReader(stream, validate_crcs=True).records:
                    self._take(record)
            # The parser may raise any exception at the end of the file.
            except Exception as error:
                if not was_cut_short(stream):
                    raise RecordingError(
                        f"{file} is damaged or no MCAP file ({error or type(error).__name__}): "
                        "copy it again.") from None

    def _take(self, record: mcap.records.McapRecord) -> None:
        if isinstance(record, mcap.records.Message):
            self.writer.write(self._channels[record.channel_id], record.data, record.log_time)
        elif isinstance(record, mcap.records.Schema):
            self._schemas[record.id] = record
        elif isinstance(record, mcap.records.Channel):
            if record.topic not in self._topics:
                self._topics[record.topic] = self._announce(record)
            self._channels[record.id] = self._topics[record.topic]
        elif isinstance(record, mcap.records.Attachment):
            self.writer.attach(record.name, record.data)
        elif isinstance(record, mcap.records.Metadata) and record.name == STAGE_METADATA:
            self.writer.add_metadata(record.metadata)

    def _announce(self, channel: mcap.records.Channel) -> int:
        schema = self._schemas[channel.schema_id]
        return self.writer.add_topic(channel.topic, MessageDefinition(
            schema.name, schema.data.decode(), channel.metadata.get("topic_type_hash", "")),
            profiles_from_text(channel.metadata.get("offered_qos_profiles", "")))


def repair_given(options: argparse.Namespace) -> None:
    """Make a complete recording, and print what was kept."""
    messages = repair(options.recording, options.output)
    print(f"{messages} messages kept in {options.output}")
    print_next(options, "piezo_recorder", "report", options.output)
