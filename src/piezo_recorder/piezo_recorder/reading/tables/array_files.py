# SPDX-License-Identifier: BSD-3-Clause
"""Named arrays: NumPy's .npy and .npz, sound, HDF5, and MATLAB files based on it."""

import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.reading.tables.libraries import library
from piezo_recorder.reading.tables.table import Progress, Table, array_columns, equal_length, joined

LARGEST_BYTES = 16_000_000_000
UNIT_ATTRIBUTES = ("unit", "units", "Unit", "Units", "unit_string")

_MATLAB_HIDDEN = ("#refs#", "#subsystem#")


class Group:
    """Columns and single numbers of one group of a file, as they are collected."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.columns: dict[str, np.ndarray] = {}
        self.units: dict[str, str] = {}
        self.scalars: dict[str, float] = {}

    def take(self, name: str, values: Any, unit: str = "") -> None:
        """Add an array or a single number; anything else is ignored."""
        array = np.asarray(values)
        if array.dtype.kind in "iuf" and array.size == 1:
            self.scalars[name] = float(array.reshape(-1)[0])
        columns = array_columns(name, array)
        self.columns |= columns
        unit = "s" if array.dtype.kind in "mM" else unit
        if unit:
            self.units |= dict.fromkeys(columns, unit)

    def table(self, path: Path) -> Table:
        """Return the columns of the most common length as a table."""
        columns = equal_length(self.columns)
        left_out = {name: len(values) for name, values in self.columns.items()
                    if name not in columns}
        return Table(path, columns, self.units, self.scalars, self.title, left_out=left_out)


def tables_of(path: Path, groups: list[Group]) -> list[Table]:
    """Return a table for each group that holds columns, and one of all groups together.

    The last one serves files that keep each signal in a group of its own.
    """
    filled = [group for group in groups if group.columns]
    if len(groups) == 1:
        return [group.table(path) for group in filled]
    whole = Group("")
    for group in groups:
        whole.columns |= {joined(group.title, name): values
                          for name, values in group.columns.items()}
        whole.units |= {joined(group.title, name): unit for name, unit in group.units.items()}
        whole.scalars |= group.scalars
    root = next((group.scalars for group in groups if not group.title), {})
    for group in filled:
        group.scalars = root | group.scalars
    return [*(group.table(path) for group in filled), whole.table(path)]


@contextmanager
def damage_reported(path: Path, kind: str) -> Iterator[None]:
    """Convert any error of a library on damaged bytes to a one-line message."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except RecordingError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise RecordingError(
            f"{path} is a damaged {kind} ({reason}): copy or save it again") from None


def read_npy(path: Path, progress: Progress) -> list[Table]:
    """Read an array of NumPy; columns without names are numbered."""
    with damage_reported(path, "NumPy file"):
        values = np.load(path, mmap_mode="r")
        group = Group("")
        group.take("", values)
    return tables_of(path, [group])


def read_npz(path: Path, progress: Progress) -> list[Table]:
    """Read the arrays of an .npz."""
    group = Group("")
    with damage_reported(path, "NumPy file"):
        with zipfile.ZipFile(path) as archive:
            size = sum(each.file_size for each in archive.infolist())
        if size > LARGEST_BYTES:
            raise RecordingError(f"{path} unpacks to {size} bytes, more than the {LARGEST_BYTES} "
                                 "that are read at once: cut it into parts")
        with np.load(path) as arrays:
            for number, name in enumerate(arrays.files, start=1):
                try:
                    group.take(name, arrays[name])
                except ValueError as error:
                    # An array of objects is skipped; others may be columns.
                    if "Object arrays" not in str(error):
                        raise
                progress(f"read {path.name}", number / len(arrays.files))
    return tables_of(path, [group])


def read_wav(path: Path, progress: Progress) -> list[Table]:
    """Read the channels of a sound file in counts, and its rate."""
    from scipy.io import wavfile

    group = Group("")
    with damage_reported(path, "WAV file"):
        rate_hz, values = wavfile.read(path)
        group.take("channel", values)
        group.scalars["rate"] = float(rate_hz)
    return tables_of(path, [group])


def read_hdf5(path: Path, progress: Progress) -> list[Table]:
    """Read the datasets of an HDF5 file, or of a MATLAB file of version 7.3."""
    h5py = library("h5py", path)
    groups = {"": Group("")}
    with damage_reported(path, "HDF5 file"), h5py.File(path, "r") as file:
        found: list[tuple[str, Any]] = []
        file.visititems(lambda name, node: found.append((name, node)))
        for number, (name, node) in enumerate(found, start=1):
            if isinstance(node, h5py.Dataset) and not name.startswith(_MATLAB_HIDDEN):
                _take_dataset(groups, name, node)
            progress(f"read {path.name}", number / len(found))
        return tables_of(path, list(groups.values()))


def _take_dataset(groups: dict[str, Group], name: str, node: Any) -> None:
    title, _, own = name.replace("/", ".").rpartition(".")
    if node.dtype.kind not in "iufbV" or node.size * node.dtype.itemsize > LARGEST_BYTES:
        return
    if node.attrs.get("MATLAB_class") in (b"char", "char"):
        return
    if node.dtype.names and len(node.shape) == 1 and "values_block_0" in node.dtype.names:
        return  # of a format that only pandas can read
    attributes = {key: node.attrs[key] for key in UNIT_ATTRIBUTES if key in node.attrs}
    unit = next(iter(attributes.values()), "")
    group = groups.setdefault(title, Group(title))
    group.take(own, node[()], unit.decode() if isinstance(unit, bytes) else str(unit))
