# SPDX-License-Identifier: BSD-3-Clause
"""Recordings as pandas frames, where pandas is installed."""

from os import PathLike
from typing import TYPE_CHECKING, Any

from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import Recording, RecordingError

if TYPE_CHECKING:
    import pandas


def to_frame(recording: Recording) -> "pandas.DataFrame":
    """Return the samples of a recording as a frame.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    pandas.DataFrame
        One row a sample, indexed by ``time_s``, with the columns ``sample_index``, ``voltage_v``,
        ``displacement_um``, ``flags`` and those of a CSV file beside.

    Raises
    ------
    RecordingError
        If pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise RecordingError("pandas is not installed: install it (`pip install pandas`), "
                             "or use the arrays of read_recording.") from None
    columns = {
        "sample_index": recording.sample_index, "voltage_v": recording.voltage_v,
        "displacement_um": recording.displacement_um, "flags": recording.flags,
        **recording.columns}
    return pandas.DataFrame(columns, index=pandas.Index(recording.time_s, name="time_s"))


def read_frame(path: str | PathLike[str], **options: Any) -> "pandas.DataFrame":
    """Read a recording as a frame.

    Parameters
    ----------
    path : path-like
        Rosbag2 directory, MCAP or CSV file.
    **options
        Of `piezo_recorder.reading.reader.read_recording`.

    Returns
    -------
    pandas.DataFrame
        See `to_frame`.

    Raises
    ------
    RecordingError
        If the recording cannot be read, or pandas is not installed.
    """
    return to_frame(read_recording(path, **options))
