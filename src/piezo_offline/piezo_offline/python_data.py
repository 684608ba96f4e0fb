# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of data given in Python: paths, arrays by name, frames, recordings, responses."""

import re
import warnings
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import control
from numpy.typing import ArrayLike

from piezo_identification.axes.axes_response import (
    AxesResponse,
    is_axes_response,
    read_axes_response,
)
from piezo_identification.estimators.frequency_response.response_file import (
    FrequencyResponse,
    is_frequency_response,
    read_frequency_response,
)
from piezo_recorder.reading.axes import (
    AxesRecording,
    axes_of_labels,
    axes_recordings_in,
    is_of_axes,
    read_axes,
)
from piezo_recorder.reading.columns import parse_columns
from piezo_recorder.reading.memory import IN_MEMORY, recording_of
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import Recording, RecordingError

if TYPE_CHECKING:
    import pandas
    import xarray


SIGNALS = ("time_s", "voltage_v", "displacement_um")
"""Names of three arrays without labels."""


class DataWarning(UserWarning):
    """Something about the data was assumed, corrected, or is implausible."""


@overload
def read(
    data: "str | PathLike[str] | Mapping[str, ArrayLike] | pandas.DataFrame | xarray.Dataset "
          "| Recording",
    columns: Sequence[str] = (), name: str = "",
) -> Recording: ...


@overload
def read(data: ArrayLike, columns: ArrayLike, name: ArrayLike) -> Recording: ...


def read(data: Any, columns: Any = (), name: Any = "") -> Recording:
    """Return a recording of a file, of arrays, of a pandas frame or of an xarray dataset.

    ``read(time_s, voltage_v, displacement_um)`` takes three arrays of equal length.

    Assumptions, corrections and implausible values are reported as `DataWarning`.

    Parameters
    ----------
    data : path-like, mapping, pandas.DataFrame, xarray.Dataset or Recording
        A rosbag2 directory, an MCAP file or a table of another program; or arrays of equal length
        by label, for example ``{"time_s": t, "voltage_v": u, "displacement_um": y}``; or a frame
        with such columns, whose index may be the time; or a dataset with such variables over
        time, with units in their attribute ``units``. A recording is returned unchanged.
    columns : str or sequence of str
        Assignments that labels and units do not contain, for example ``["time=t[ms]",
        "voltage=ch1[20V]"]``, or ``["rate=10[kHz]"]`` for data without time.
    name : str
        Name for arrays or a frame.

    Raises
    ------
    piezo_recorder.RecordingError
        If the data are missing, ambiguous or damaged; the message says where, and what to do.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = 1e-3 * np.arange(500)
    >>> voltage_v = 5.0 - 5.0 * np.cos(20.0 * time_s)
    >>> read(time_s, voltage_v, 2.0 * voltage_v)
    <Recording data in memory: 500 samples every 0.001 s, 0 to 10 V, 0 to 20 um>
    >>> labelled = {"t [ms]": 1e3 * time_s, "U [V]": voltage_v, "y [nm]": 2e3 * voltage_v}
    >>> read(labelled).sample_period_s
    0.001
    """
    if isinstance(data, Recording):
        return data
    if not isinstance(name, str):
        data, columns, name = dict(zip(SIGNALS, (data, columns, name), strict=True)), (), ""
    words = [columns] if isinstance(columns, str) else list(columns)
    if not all(isinstance(word, str) for word in words):
        raise RecordingError("columns holds no words: give three arrays, as in read(time_s, "
                             "voltage_v, displacement_um), or words such as voltage=ch1[20V]")
    if isinstance(data, str | PathLike) and not words and is_of_axes(data):
        raise RecordingError(f"{data} is of several axes, which are not read alone: hand the file "
                             "itself to check, identify or simulate")
    try:
        described = parse_columns(words)
        if isinstance(data, str | PathLike):
            recording = read_recording(data, columns=described)
        else:
            recording = recording_of(data, described, name or IN_MEMORY)
    except RecordingError as error:
        raise RecordingError(_in_python(str(error))) from None
    for note in dict.fromkeys(recording.notes):
        warnings.warn(note, DataWarning, stacklevel=2)
    return recording


def _in_python(text: str) -> str:
    """Return a message with its option ``--columns`` written as the argument in Python."""
    def as_argument(found: re.Match[str]) -> str:
        return "columns=[" + ", ".join(f'"{word}"' for word in found[1].split()) + "]"

    return re.sub(r"--columns (\w+=[^\s),;:]+(?: \w+=[^\s),;:]+)*)", as_argument, text).replace(
        "--columns", "columns")


def in_list(given: Any) -> list[Any]:
    """Return one or several objects as a list."""
    return list(given) if isinstance(given, list | tuple) else [given]


def axes_recordings_of(given: Any, name: str) -> list[AxesRecording]:
    """Return the given recordings of several axes; empty if they are of one axis.

    `given` is a path, a mapping of str to array, an AxesRecording, or a list or tuple of such.
    `name` is that of recordings from arrays. Raise piezo_recorder.RecordingError if a file or
    arrays of several axes are invalid.
    """
    response = axes_response_in(given)
    if response is not None:
        raise RecordingError(f"{response.name} is a frequency response of several axes: give it "
                             "alone, as the dynamics of identify")
    if isinstance(given, list | tuple):
        return [recording for each in given for recording in axes_recordings_of(each, name)]
    if isinstance(given, AxesRecording):
        return [given]
    if isinstance(given, str | PathLike) and is_of_axes(given):
        return read_axes(given)
    if isinstance(given, Mapping) and len(axes_of_labels(list(given))) > 1:
        return axes_recordings_in(given, name)
    return []


def axes_data_of(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the given recordings or response of several axes; empty if they are of one axis.

    The data are given by what they show, with None for no data; those of "dynamics" may be one
    frequency response. The values of the result are lists of AxesRecording, or an AxesResponse.
    Raise piezo_recorder.RecordingError if some are of one axis and others of several, or a file or
    arrays are invalid.
    """
    response = axes_response_in(given["dynamics"])
    found = {name: [axes_recordings_of(each, name) for each in in_list(data)]
             for name, data in given.items()
             if data is not None and not (response and name == "dynamics")}
    are_of_axes = [bool(each) for listed in found.values() for each in listed]
    if not response and not any(are_of_axes):
        return {}
    if not all(are_of_axes):
        raise RecordingError("some data are of one axis and others of several: give data of one "
                             "stage")
    of_axes = {name: [recording for each in listed for recording in each]
               for name, listed in found.items()}
    return {"dynamics": response or ()} | of_axes


def axes_response_in(given: Any) -> AxesResponse | None:
    """Return the given frequency response of several axes, or None if the data are not one."""
    if isinstance(given, control.FrequencyResponseData):
        return AxesResponse.from_control(given)
    if isinstance(given, str | PathLike) and is_axes_response(given):
        return read_axes_response(given)
    return given if isinstance(given, AxesResponse) else None


def recordings_of(given: Any, columns: Sequence[str], name: str) -> list[Recording]:
    """Return one recording or several as a list; see `read`.

    `given` is what `read` takes, or a list or tuple of such. `name` is that of arrays and frames,
    which are numbered if there are several.
    """
    listed = in_list(given)
    names = [f"{name} {number}" if number > 1 else name for number in range(1, len(listed) + 1)]
    return [read(each, columns, called) for each, called in zip(listed, names, strict=True)]


def response_in(given: Any) -> FrequencyResponse | None:
    """Return the given frequency response, or None if the data are not one."""
    if isinstance(given, FrequencyResponse):
        return given
    if isinstance(given, str | PathLike) and is_frequency_response(Path(given)):
        return read_frequency_response(Path(given))
    return None
