# SPDX-License-Identifier: BSD-3-Clause
"""Recordings as pandas frames and xarray datasets, if these libraries are installed."""

from collections.abc import Iterable
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from piezo_common.extras import how_to_install
from piezo_recorder.reading.reader import read_recording
from piezo_recorder.reading.recording import Recording, RecordingError
from piezo_recorder.sample_block import Flag

if TYPE_CHECKING:
    import pandas
    import xarray

UNITS = {"voltage_v": "V", "displacement_um": "um"}
"""Units of the signals; those of further columns of a table are in their labels only."""


def to_frame(recording: Recording) -> "pandas.DataFrame":
    """Return the samples of a recording as a frame.

    Returns
    -------
    pandas.DataFrame
        One row per sample, indexed by ``time_s``, with the columns ``sample_index``,
        ``voltage_v``, ``displacement_um``, ``flags``, ``reference_um`` if a run was recorded, and
        the further columns of a CSV file; for several axes ``x_voltage_v`` and so on. Its
        ``attrs`` hold ``units`` by column, ``source`` and ``sample_rate_hz``.

    Raises
    ------
    RecordingError
        If pandas is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = 1e-3 * np.arange(500)
    >>> voltage_v = 5.0 - 5.0 * np.cos(20.0 * time_s)
    >>> from piezo_recorder import recording_of
    >>> recording = recording_of(
    ...     {"time_s": time_s, "voltage_v": voltage_v, "displacement_um": 2.0 * voltage_v})
    >>> frame = to_frame(recording)
    >>> frame.attrs["units"]["displacement_um"], recording_of(frame).voltage_v.size
    ('um', 500)
    """
    try:
        import pandas
    except ImportError:
        raise RecordingError("pandas is not installed: "
                             f"{how_to_install('pandas', 'frames')}, "
                             "or use the arrays of read_recording.") from None
    frame = pandas.DataFrame(
        _columns_of(recording), index=pandas.Index(recording.time_s, name="time_s"))
    frame.attrs = {"units": {"time_s": "s", **_units_of(frame)}, **_origin_of(recording)}
    return frame


def to_xarray(recording: Recording) -> "xarray.Dataset":
    """Return the samples of a recording as a dataset over time, with units.

    Returns
    -------
    xarray.Dataset
        The variables have the names of the columns of `to_frame`, and the single dimension
        ``time_s``. Their ``units``, and the ``flag_masks`` and ``flag_meanings`` of ``flags``,
        follow the CF conventions for netCDF files. ``attrs`` hold ``source`` and
        ``sample_rate_hz``.

    Raises
    ------
    RecordingError
        If xarray is not installed.

    Examples
    --------
    >>> to_xarray(recording)["voltage_v"].attrs["units"]      # that of `to_frame`
    'V'
    """
    try:
        import xarray
    except ImportError:
        raise RecordingError("xarray is not installed: "
                             f"{how_to_install('xarray', 'frames')}, "
                             "or use the arrays of read_recording.") from None
    columns = {"time_s": recording.time_s, **_columns_of(recording)}
    dataset = xarray.Dataset(
        {name: ("time_s", values) for name, values in columns.items()},
        attrs=_origin_of(recording))
    for name, unit in {"time_s": "s", **_units_of(columns)}.items():
        dataset[name].attrs = {"units": unit, "long_name": name.rpartition("_")[0]}
    dataset["flags"].attrs = {
        "flag_masks": np.array([flag.value for flag in Flag], dtype=np.uint32),
        "flag_meanings": " ".join(str(flag.name).lower() for flag in Flag)}
    return dataset


def read_frame(path: str | PathLike[str], **options: Any) -> "pandas.DataFrame":
    """Read a recording as a frame.

    Parameters
    ----------
    path : path-like
        Rosbag2 directory, MCAP or CSV file.
    **options
        Options of `piezo_recorder.reading.reader.read_recording`.

    Returns
    -------
    pandas.DataFrame
        Samples as from `to_frame`.

    Raises
    ------
    RecordingError
        If the recording cannot be read, or pandas is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = 1e-3 * np.arange(500)
    >>> voltage_v = 5.0 - 5.0 * np.cos(20.0 * time_s)
    >>> np.savetxt("mine.csv", np.column_stack([time_s, voltage_v, 2.0 * voltage_v]),
    ...            delimiter=",", comments="", header="time_s,voltage_v,displacement_um")
    >>> read_frame("mine.csv").shape[0]
    500
    """
    return to_frame(read_recording(path, **options))


def _columns_of(recording: Recording) -> dict[str, np.ndarray]:
    return {"sample_index": recording.sample_index, **recording.signals, "flags": recording.flags,
            **({"reference_um": recording.reference_um} if recording.reference_um.size else {}),
            **recording.columns}


def _units_of(columns: Iterable[str]) -> dict[str, str]:
    return {label: unit for label in columns for name, unit in UNITS.items()
            if label == name or label.endswith(f"_{name}")}


def _origin_of(recording: Recording) -> dict[str, Any]:
    return {"source": f"{recording.path} {recording.title}".rstrip(),
            "sample_rate_hz": float(recording.sample_rate_hz)}
