# SPDX-License-Identifier: BSD-3-Clause
"""Recordings from data in memory: arrays by name, frames, datasets."""

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from piezo_recorder.reading.columns import GUESSED, ColumnsDocument
from piezo_recorder.reading.recording import Recording, RecordingError
from piezo_recorder.reading.table_reader import recordings_of
from piezo_recorder.reading.tables.table import Table, array_columns
from piezo_recorder.reading.units import name_and_unit

if TYPE_CHECKING:
    import pandas
    import xarray

IN_MEMORY = "data in memory"
"""Name that a recording has instead of a file."""

OF_OUR_FRAMES = {"sample_index", "flags", "voltage_v", "displacement_um"}
"""Columns that identify a frame or dataset of `piezo_recorder.reading.frames`."""


def recording_of(data: "Mapping[str, ArrayLike] | pandas.DataFrame | xarray.Dataset",
                 columns: ColumnsDocument = GUESSED, name: str = IN_MEMORY) -> Recording:
    """Return the single recording in arrays, a frame or a dataset; see `recordings_in`.

    Parameters
    ----------
    data : mapping of str to array_like, shape (N,), pandas.DataFrame or xarray.Dataset

    Raises
    ------
    RecordingError
        If the data are invalid, see `recordings_in`, or if there are several recordings.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = 1e-3 * np.arange(500)
    >>> voltage_v = 5.0 - 5.0 * np.cos(20.0 * time_s)
    >>> recording_of({"time_s": time_s, "voltage_v": voltage_v, "displacement_um": 2.0 * voltage_v})
    <Recording data in memory: 500 samples every 0.001 s, 0 to 10 V, 0 to 20 um>
    """
    found = recordings_in(data, columns, name)
    if len(found) > 1:
        raise RecordingError(f"{name} holds {len(found)} recordings, as its time begins again: "
                             "give one of them, or read all by recordings_in")
    return found[0]


def recordings_in(data: "Mapping[str, ArrayLike] | pandas.DataFrame | xarray.Dataset",
                  columns: ColumnsDocument = GUESSED, name: str = IN_MEMORY) -> list[Recording]:
    """Return the recordings in arrays, a frame or a dataset, by the same rules as for tables.

    Parameters
    ----------
    data : mapping of str to array_like, shape (N,), pandas.DataFrame or xarray.Dataset
        Columns by label, such as ``time_s``, ``Vpiezo [V]`` and ``pos_nm``; the index of a frame
        is a column unless it is only the row number. The variables and coordinates of a dataset
        are columns, with their attribute ``units``.
    columns : ColumnsDocument
        Description of the columns, e.g. from `piezo_recorder.reading.columns.parse_columns`.
    name : str
        Name in place of the path of a file, also in messages.

    Raises
    ------
    RecordingError
        If a signal is missing or ambiguous, columns have different lengths, a value is not
        finite, or the time does not rise evenly.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = 1e-3 * np.tile(np.arange(250), 2)           # begins anew
    >>> voltage_v = 5.0 - 5.0 * np.cos(20.0 * time_s)
    >>> found = recordings_in({"time_s": time_s, "voltage_v": voltage_v, "y [nm]": 2e3 * voltage_v})
    >>> [each.voltage_v.size for each in found]
    [250, 250]
    """
    labelled = _columns_of(data)
    own = labelled.keys() >= OF_OUR_FRAMES
    table = Table(Path(name), {})
    for label, values in labelled.items():
        table.columns |= array_columns(label, values)
    lengths = {label: len(values) for label, values in table.columns.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"'{label}' {length}" for label, length in lengths.items())
        raise RecordingError(f"{name}: columns have different numbers of values ({listed}): give "
                             "arrays of one length")
    if not table.columns:
        raise RecordingError(f"{name} holds no columns of numbers: give arrays of time, voltage "
                             "and displacement by name, such as time_s, voltage_v, "
                             "displacement_um")
    return [_identified_by_hash(_with_flags(recording) if own else recording)
            for recording in recordings_of([table], columns)]


def _columns_of(data: Any) -> dict[str, Any]:
    """Return the columns by label, including a frame's index if it is more than a row number."""
    if hasattr(data, "data_vars"):
        return {_label_of(str(name), str(variable.attrs.get("units", ""))): variable.to_numpy()
                for name, variable in data.variables.items()}
    index: Any = getattr(data, "index", None)
    if hasattr(index, "to_numpy"):
        counts = index.name is None and getattr(index, "step", None) == 1
        time = {} if counts else {str(index.name or "time"): index.to_numpy()}
        return time | {str(label): data[label].to_numpy() for label in data.columns}
    if not isinstance(data, Mapping):
        raise RecordingError(f"a {type(data).__name__} is no recording: give a path, arrays by "
                             "name such as {'time_s': ..., 'voltage_v': ..., "
                             "'displacement_um': ...}, a pandas frame or an xarray dataset")
    return {str(label): np.asarray(values) for label, values in data.items()}


def _label_of(name: str, unit: str) -> str:
    """Return the label of a variable with its unit, unless the name itself ends with one."""
    return f"{name} [{unit}]" if unit and not name_and_unit(name)[1] else name


def _with_flags(recording: Recording) -> Recording:
    """Return a recording from frames or datasets of this package with its original flags."""
    further = dict(recording.columns)
    flags = further.pop("flags")
    further.pop("sample_index")
    if np.any(flags != np.round(flags)) or flags.min() < 0:  # between rows of an uneven time
        return replace(recording, columns=further)
    return replace(recording, columns=further, flags=flags.astype(np.uint32))


def _identified_by_hash(recording: Recording) -> Recording:
    return replace(recording, sha256=hash_of(
        recording.sample_index, recording.sample_periods_s, recording.voltage_v,
        recording.displacement_um))


def hash_of(*arrays: np.ndarray) -> str:
    """Return the SHA-256 of arrays, in place of that of a file."""
    digest = hashlib.sha256()
    for values in arrays:
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()
