# SPDX-License-Identifier: BSD-3-Clause
"""Properties of the message piezo_interfaces/msg/SampleBlock for recorder and reader."""

import enum
import struct

TYPE_NAME = "piezo_interfaces/msg/SampleBlock"
DEFAULT_SAMPLE_RATE_HZ = 40_000.0


class Flag(enum.IntFlag):
    """Bits of SampleBlock's ``flags``."""

    RANGE_LIMITED = 1
    SLEW_LIMITED = 2
    FEEDBACK_HELD = 4
    RAMPING = 8
    PLAYING = 16
    TRACKING = 32
    STOPPED = 64
    FEEDFORWARD_HELD = 128


class Mark(enum.IntFlag):
    """Bits of SampleBlock's ``marks``.

    A line and a frame begin at their sample; that of a pixel is the nearest to its centre, so that
    lines of both directions have their pixels at the same places. `BACKWARD` stands beside the
    marks of lines that go backward.
    """

    PIXEL = 1
    LINE = 2
    FRAME = 4
    BACKWARD = 8


class SampleCount:
    """Running count of the samples of one topic, in constant memory.

    Of the samples, each of which has one value per axis, `samples` were received; `missing` are the
    clock samples that no block covers, between the first block and the last; `end` is the index on
    the sample clock after the last block.
    """

    def __init__(self, sample_rate_hz: float = DEFAULT_SAMPLE_RATE_HZ, axes: int = 1):
        self._sample_rate_hz, self._axes = sample_rate_hz, axes
        self.samples = 0
        self.missing = 0
        self.end: int | None = None

    def add(self, data: bytes) -> None:
        """Count one serialised SampleBlock (bytes)."""
        first, period_s, values = block_span(data)
        samples = values // self._axes
        if self.end is not None:
            self.missing += max(0, first - self.end)
        self.samples += samples
        self.end = first + samples * max(1, round(period_s * self._sample_rate_hz))

    def missing_until(self, last_sample: int) -> int:
        """Return the number of clock samples still to come, up to and including ``last_sample``."""
        return max(0, last_sample + 1 - self.end) if self.end is not None else last_sample + 1


def block_span(data: bytes) -> tuple[int, float, int]:
    """Return first sample, sample period (s) and number of voltages of a block, from its CDR.

    Its samples are not decoded; a sample has a voltage of each axis.
    """
    order = "<" if data[1] & 1 else ">"
    frame_id_length, = struct.unpack_from(order + "I", data, 12)
    # After the frame id CDR aligns to 8 bytes, counted from the end of its own 4-byte header.
    offset = 4 + -(-(12 + frame_id_length) // 8) * 8
    first_sample, sample_period_s, _tick, values = struct.unpack_from(
        order + "QdQI", data, offset)
    return first_sample, sample_period_s, values
