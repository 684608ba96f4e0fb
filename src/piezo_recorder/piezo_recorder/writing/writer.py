# SPDX-License-Identifier: BSD-3-Clause
"""Writer of recordings: a rosbag2 directory with one MCAP file."""

import mimetypes
import os
import time
from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from typing import Any

import mcap.writer

from piezo_recorder.writing.message_definition import MessageDefinition
from piezo_recorder.writing.quality_profiles import profiles_to_text
from piezo_recorder.writing.yaml_text import to_yaml

METADATA_VERSION = 9
CHUNK_BYTES = 1024 * 1024
# Half of what may be lost if the recorder is killed.
FLUSH_PERIOD_S = 0.5
# Name of the MCAP metadata record with the rate of the sample clock.
STAGE_METADATA = "piezo_stage"


class RecordingWriter:
    """Write serialised messages into a new rosbag2 directory.

    The directory holds ``metadata.yaml`` and one MCAP file with the definitions of
    all types, so any reader of rosbag2 or MCAP decodes it. Every write passes older
    messages to the operating system after at most half a second; if messages are
    rare, call `flush` as often.

    Parameters
    ----------
    path : str or Path
        Directory to create, with its parents.
    sample_rate_hz : float, optional
        Rate of the sample clock, stored in the file for the reader.

    Raises
    ------
    FileExistsError
        If ``path`` exists already: nothing is ever overwritten.
    """

    def __init__(self, path: str | PathLike[str], sample_rate_hz: float | None = None):
        self.path = Path(path).absolute()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self.path.mkdir()
        except FileExistsError:
            raise FileExistsError(
                f"{self.path} exists already and is not overwritten: "
                "choose another name or remove it.") from None
        self._stream = open(self.path / f"{self.path.name}_0.mcap", "xb")
        self._mcap = mcap.writer.Writer(self._stream, chunk_size=CHUNK_BYTES)
        self._mcap.start(profile="ros2", library="piezo_recorder")
        if sample_rate_hz is not None:
            self.add_metadata({"sample_rate_hz": repr(sample_rate_hz)})
        self._schemas: dict[str, int] = {}
        self._topics: dict[int, tuple[str, MessageDefinition, list[dict[str, Any]]]] = {}
        self._counts: dict[int, int] = {}
        self._first_time_ns: int | None = None
        self._last_time_ns: int | None = None
        self._write_metadata()
        self.flush()

    def __enter__(self) -> "RecordingWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def message_count(self) -> int:
        """Return the number of messages written so far."""
        return sum(self._counts.values())

    def add_metadata(self, metadata: dict[str, str]) -> None:
        """Store facts on the stage, a dict of str to str, for the reader."""
        self._mcap.add_metadata(STAGE_METADATA, metadata)

    def add_topic(self, topic: str, definition: MessageDefinition,
                  quality_profiles: Iterable[dict[str, Any]] = ()) -> int:
        """Announce a topic before its first message is written.

        Parameters
        ----------
        quality_profiles : sequence of dict
            Profiles that its publishers offer, see `quality_profiles.offered_profile`; a replay
            offers the same.

        Returns
        -------
        int
            Channel number for `write`.
        """
        if definition.type_name not in self._schemas:
            self._schemas[definition.type_name] = self._mcap.register_schema(
                definition.type_name, "ros2msg", definition.text.encode())
        channel = self._mcap.register_channel(
            topic, "cdr", self._schemas[definition.type_name],
            {"offered_qos_profiles": profiles_to_text(quality_profiles),
             "topic_type_hash": definition.type_hash})
        self._topics[channel] = (topic, definition, list(quality_profiles))
        self._counts[channel] = 0
        self._write_metadata()
        return channel

    def attach(self, name: str, content: bytes) -> None:
        """Store a file in the recording."""
        media_type = mimetypes.guess_type(name)[0] or "text/plain"
        now_ns = time.time_ns()
        self._mcap.add_attachment(now_ns, now_ns, name, media_type, content)
        self.flush()

    def write(self, channel: int, data: bytes, time_ns: int) -> None:
        """Write one message.

        Parameters
        ----------
        channel : int
            Channel number from `add_topic`.
        data : bytes
            CDR as received.
        time_ns : int
            Time of reception (ns).
        """
        self._mcap.add_message(channel, time_ns, data, time_ns, self._counts[channel])
        self._counts[channel] += 1
        if self._first_time_ns is None or self._last_time_ns is None:
            self._first_time_ns = self._last_time_ns = time_ns
        self._last_time_ns = max(self._last_time_ns, time_ns)
        self._first_time_ns = min(self._first_time_ns, time_ns)
        if time.monotonic() - self._flushed_at >= FLUSH_PERIOD_S:
            self.flush()

    def flush(self) -> None:
        """Pass everything written so far to the operating system."""
        self._mcap.flush()
        self._flushed_at = time.monotonic()

    def close(self) -> None:
        """Write the index and the final ``metadata.yaml``; further calls do nothing."""
        if self._stream.closed:
            return
        try:
            self._mcap.finish()
        finally:
            self._stream.close()
        self._write_metadata()

    def _write_metadata(self) -> None:
        start_ns = self._first_time_ns or 0
        span = {
            "duration": {"nanoseconds": (self._last_time_ns or 0) - start_ns},
            "starting_time": {"nanoseconds_since_epoch": start_ns},
            "message_count": self.message_count,
        }
        file_name = Path(self._stream.name).name
        metadata = {"rosbag2_bagfile_information": {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": [
                _topic_metadata(*topic, self._counts[channel])
                for channel, topic in self._topics.items()],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file_name],
            "files": [{"path": file_name, **span}],
            "custom_data": None,
            "ros_distro": "jazzy",
        }}
        # Replaced as a whole, so that a kill leaves either the old or the new file.
        complete = self.path / ".metadata.yaml"
        complete.write_text(to_yaml(metadata), encoding="utf-8")
        os.replace(complete, self.path / "metadata.yaml")


def _topic_metadata(topic: str, definition: MessageDefinition,
                    quality_profiles: list[dict[str, Any]], count: int) -> dict[str, Any]:
    return {
        "topic_metadata": {
            "name": topic,
            "type": definition.type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": quality_profiles,
            "type_description_hash": definition.type_hash,
        },
        "message_count": count,
    }
