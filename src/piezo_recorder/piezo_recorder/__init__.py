# SPDX-License-Identifier: BSD-3-Clause
"""Recording of stage samples as rosbag2 MCAP, and the reader of recordings."""

from typing import TYPE_CHECKING

from piezo_common.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from piezo_recorder.images.scan_frame import ScanFrame
    from piezo_recorder.images.scan_image import ScanImage, image_of
    from piezo_recorder.reading.axes import (
        AxesRecording,
        axes_recordings_in,
        axes_recordings_of_arrays,
        read_axes,
    )
    from piezo_recorder.reading.columns import ColumnsDocument, parse_columns
    from piezo_recorder.reading.frames import read_frame, to_frame, to_xarray
    from piezo_recorder.reading.memory import recording_of, recordings_in
    from piezo_recorder.reading.reader import read_recording, read_recordings, sha256_of
    from piezo_recorder.reading.recording import Recording, RecordingError
    from piezo_recorder.sample_block import Flag
    from piezo_recorder.writing.message_definition import MessageDefinition
    from piezo_recorder.writing.repair import repair
    from piezo_recorder.writing.writer import RecordingWriter

__getattr__, __dir__ = lazy_exports(__name__, __file__)

__all__ = [
    "AxesRecording", "ColumnsDocument", "Flag", "MessageDefinition", "Recording", "RecordingError",
    "RecordingWriter", "ScanFrame", "ScanImage", "axes_recordings_in", "axes_recordings_of_arrays",
    "image_of", "parse_columns", "read_axes", "read_frame", "read_recording", "read_recordings",
    "recording_of", "recordings_in", "repair", "sha256_of", "to_frame", "to_xarray",
]
