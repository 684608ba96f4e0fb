# SPDX-License-Identifier: BSD-3-Clause
"""A recording in progress."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

from piezo_recorder import sample_block
from piezo_recorder.sample_block import SampleCount
from piezo_recorder.writing.message_definition import MessageDefinition
from piezo_recorder.writing.writer import RecordingWriter

# Messages that belong to the last sample may come after it on other topics.
QUIET_S = 0.02


class RecordingSession:
    """A recording in progress, and the counts of its samples.

    The profiles are those that the publishers of each topic offer.
    """

    def __init__(self, writer: RecordingWriter, definitions: Mapping[str, MessageDefinition],
                 sample_rate_hz: float, axes: int, client: Any,
                 quality_profiles: Mapping[str, Sequence[dict[str, Any]]]):
        self.writer = writer
        self.client = client
        self.ended_early = ""
        self.closed = False
        self._received_at = 0.0
        self._channels = {
            topic: writer.add_topic(topic, definition, quality_profiles[topic])
            for topic, definition in definitions.items()}
        self._counts = {
            topic: SampleCount(sample_rate_hz, axes) for topic, definition in definitions.items()
            if definition.type_name == sample_block.TYPE_NAME}

    @property
    def path(self) -> str:
        """Return the path of the recording."""
        return str(self.writer.path)

    @property
    def quiet(self) -> bool:
        """Return whether no message has come for `QUIET_S`."""
        return time.monotonic() - self._received_at > QUIET_S

    @property
    def samples(self) -> int:
        """Return the number of samples received on the first topic of samples."""
        return next(iter(self._counts.values())).samples

    @property
    def missing(self) -> int:
        """Return the number of samples that no block of the first topic of samples covers."""
        return next(iter(self._counts.values())).missing

    def receive(self, topic: str, data: bytes, time_ns: int) -> None:
        """Write one message and count its samples."""
        self._received_at = time.monotonic()
        self.writer.write(self._channels[topic], data, time_ns)
        if topic in self._counts:
            self._counts[topic].add(data)

    def missing_until(self, last_sample: int) -> int:
        """Return the number of samples still to come on the topic that is furthest behind.

        Topics without any message, such as the ground truth of a stage that has none, are ignored,
        except the first.
        """
        first, *others = self._counts.values()
        started = [first, *(count for count in others if count.end is not None)]
        return max(count.missing_until(last_sample) for count in started)

    def close(self) -> None:
        """Close the recording; nothing more is written."""
        self.closed = True
        self.writer.close()
