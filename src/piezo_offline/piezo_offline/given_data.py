# SPDX-License-Identifier: BSD-3-Clause
"""What people hand over in Python: paths, arrays by name, frames, recordings, responses."""

import re
import warnings
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from numpy.typing import ArrayLike

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
"""Labels of three arrays that have none."""


class DataWarning(UserWarning):
    """Something of the data was assumed, mended, or is implausible."""


@overload
def read(
    data: "str | PathLike[str] | Mapping[str, ArrayLike] | pandas.DataFrame | xarray.Dataset "
          "| Recording",
    columns: Sequence[str] = (), name: str = "",
) -> Recording: ...


@overload
def read(data: ArrayLike, columns: ArrayLike, name: ArrayLike) -> Recording: ...


def read(data: Any, columns: Any = (), name: Any = "") -> Recording:
    """Make a recording of a file, of arrays, of a pandas frame or of an xarray dataset.

    ``read(time_s, voltage_v, displacement_um)`` takes three arrays of one length.

    What had to be assumed or mended, and what is implausible, is said as a `DataWarning`.

    Parameters
    ----------
    data : path-like, mapping, pandas.DataFrame, xarray.Dataset or Recording
        A rosbag2 directory, an MCAP file or a table of another program; or arrays of one length
        by label, such as ``{"time_s": t, "voltage_v": u, "displacement_um": y}``; or a frame with
        such columns, whose index may be the time; or a dataset with such variables over time,
        whose attribute ``units`` counts. A recording is returned as it is.
    columns : sequence of str
        What the labels and units do not tell, such as ``["time=t[ms]", "voltage=ch1[20V]"]``, or
        ``["rate=10[kHz]"]`` where there is no time.
    name : str
        What to call arrays or a frame.

    Raises
    ------
    piezo_recorder.RecordingError
        If the data are missing, ambiguous or damaged; one line says where, and what to do.

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
    if isinstance(data, str | PathLike) and not columns and is_of_axes(data):
        raise RecordingError(f"{data} is of several axes, which are not read alone: hand the file "
                             "itself to check, identify or simulate")
    try:
        said = parse_columns(list(columns))
        if isinstance(data, str | PathLike):
            recording = read_recording(data, columns=said)
        else:
            recording = recording_of(data, said, name or IN_MEMORY)
    except RecordingError as error:
        raise RecordingError(_in_python(str(error))) from None
    for note in dict.fromkeys(recording.notes):
        warnings.warn(note, DataWarning, stacklevel=2)
    return recording


def _in_python(text: str) -> str:
    """Return a message with its option ``--columns`` as the argument that it is in Python."""
    def as_argument(found: re.Match[str]) -> str:
        return "columns=[" + ", ".join(f'"{word}"' for word in found[1].split()) + "]"

    return re.sub(r"--columns (\w+=[^\s),;:]+(?: \w+=[^\s),;:]+)*)", as_argument, text).replace(
        "--columns", "columns")


def in_list(given: Any) -> list[Any]:
    """Return what was given, one or several, as a list."""
    return list(given) if isinstance(given, list | tuple) else [given]


def axes_recordings_of(given: Any, name: str) -> list[AxesRecording]:
    """Return the recordings of several axes that were handed over; none where they are of one.

    Parameters
    ----------
    given : path-like, mapping of str to array, AxesRecording, or a list or tuple of such
    name : str
        Of arrays.

    Raises
    ------
    piezo_recorder.RecordingError
        If a file or arrays of several axes do not fit.
    """
    if isinstance(given, list | tuple):
        return [recording for each in given for recording in axes_recordings_of(each, name)]
    if isinstance(given, AxesRecording):
        return [given]
    if isinstance(given, str | PathLike) and is_of_axes(given):
        return read_axes(given)
    if isinstance(given, Mapping) and len(axes_of_labels(list(given))) > 1:
        return axes_recordings_in(given, name)
    return []


def recordings_of(given: Any, columns: Sequence[str], name: str) -> list[Recording]:
    """Return one recording or several as a list; see `read`.

    Parameters
    ----------
    given : as `read` takes, or a list or tuple of such
    name : str
        Of arrays and frames, numbered where there are several.
    """
    listed = in_list(given)
    names = [f"{name} {number}" if number > 1 else name for number in range(1, len(listed) + 1)]
    return [read(each, columns, called) for each, called in zip(listed, names, strict=True)]


def response_in(given: Any) -> FrequencyResponse | None:
    """Return the frequency response that was handed over, or None where there is none."""
    if isinstance(given, FrequencyResponse):
        return given
    if isinstance(given, str | PathLike) and is_frequency_response(Path(given)):
        return read_frequency_response(Path(given))
    return None
