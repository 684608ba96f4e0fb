# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of two or three axes: of a stage, of tables with columns for each, and of arrays."""

import json
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.schema import Document, Number, Part, Positive, SchemaError, entry, load_document
from piezo_recorder.reading.columns import ColumnsDocument, SignalColumn
from piezo_recorder.reading.detected import marks_in, signals_in
from piezo_recorder.reading.memory import IN_MEMORY, hash_of, recordings_in
from piezo_recorder.reading.reader import (
    axes_of_messages,
    holds_messages,
    read_recording,
    read_recordings,
)
from piezo_recorder.reading.recording import Recording, RecordingError
from piezo_recorder.reading.tables.array_files import damage_reported
from piezo_recorder.reading.tables.file_kinds import read_tables
from piezo_recorder.reading.tables.table import no_progress
from piezo_recorder.reading.units import scale_of

MOST_AXES = 3
FORMAT = "piezo_axes_arrays"
HEAD_BYTES = 1 << 16
"""Length of the beginning of a file that contains the labels of a table."""
ZIP_MAGIC = b"PK\x03\x04"
PARAMETERS = "parameters.json"
"""Attachment of an experiment's recording that contains the number of repeats."""

_VOLTAGE = re.compile(r"([a-z][a-z0-9]*)_voltage_v")
"""Label of the voltage of an axis, with the axis' short lower-case name before the unit."""


@dataclass(frozen=True, eq=False)
class AxesRecording:
    """Samples of two or three axes on one clock."""

    path: str
    """Path of the file that was read."""
    axes: tuple[str, ...]
    """Names, in the order of the columns."""
    sample_period_s: float

    voltage_v: np.ndarray
    displacement_um: np.ndarray
    """Shape (N, n)."""
    periods: int = 0
    """Number of equal periods of the voltage, measured after the stage had settled; 0 if it is
    unknown."""
    title: str = ""
    """Title that distinguishes several recordings of one file."""
    sha256: str = ""
    """Hash of the samples."""
    notes: tuple[str, ...] = ()
    """Assumptions and corrections made while reading, for users."""
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Further columns, each of shape (N,), such as ``pixel`` and ``camera_signal``."""
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    """Files that are stored in the recording."""

    def __repr__(self) -> str:
        return (f"<AxesRecording {self.name}: {len(self.voltage_v)} samples of "
                f"{', '.join(self.axes)} at {1.0 / self.sample_period_s:.6g} Hz>")

    @property
    def name(self) -> str:
        """Return path and title."""
        return f"{self.path} {self.title}".rstrip()

    @property
    def marks(self) -> np.ndarray:
        """Return the bits of `piezo_recorder.sample_block.Mark`, (N,); empty without marks."""
        return marks_in(self.columns)

    @property
    def signals(self) -> dict[str, np.ndarray]:
        """Return what each detector measured at the instants of the displacements, (N,)."""
        return signals_in(self.columns)

    @property
    def amplitude_v(self) -> float:
        """Return the rms of all voltages about their means."""
        return float(np.sqrt(np.mean(np.var(self.voltage_v, axis=0))))


class ChannelsPart(Part):
    """An array of the channels of all axes."""

    file: str = entry("NumPy file (.npy), next to the description.")
    unit: str = entry("Unit of its numbers, such as V, mV, um, nm or m.")
    signs: list[Number] = entry(
        "Sign or factor of each channel, such as [1, 1, -1]; 1 by default.", default=[])


class ArraysDocument(Document):
    """Description of arrays of several axes: their files, and the meaning of their dimensions."""

    TITLE: ClassVar[str] = "description of arrays"
    SYNTAX: ClassVar[str] = "yaml"
    FORMAT: ClassVar[str] = FORMAT

    format: str = entry(f"Always {FORMAT}.")
    axes: list[str] = entry("Names of the axes, in the order of the channels.")
    sample_rate_hz: Positive = entry("Samples a second.", unit="Hz")
    voltage: ChannelsPart = entry("The voltages.")
    displacement: ChannelsPart = entry("The displacements.")
    dimensions: list[Literal["sample", "channel", "realisation", "period"]] = entry(
        "What the dimensions of both arrays are. Periods are equal ones, measured one after the "
        "other once the stage had settled.", default=["sample", "channel"])
    realisations: list[Number] = entry(
        "Numbers of the realisations to read, from 1; all by default.", default=[])


def axes_with_voltage(labels: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the axes whose voltage a table contains, in its order."""
    return tuple(match[1] for match in map(_VOLTAGE.fullmatch, labels) if match)


def axes_of_labels(labels: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the axes for which a table contains both columns, in its order."""
    return tuple(axis for axis in axes_with_voltage(labels) if f"{axis}_displacement_um" in labels)


def is_of_axes(path: str | PathLike[str]) -> bool:
    """Return whether a file is a recording of several axes, or a description of such arrays."""
    path = Path(path)
    try:
        if holds_messages(path):
            return bool(axes_of_messages(path))
    except RecordingError:  # reported when the file is read
        return False
    text = head_of(path)
    if path.suffix.lower() in (".yaml", ".yml"):
        return f"format: {FORMAT}" in text
    labels = re.findall(r"[a-z][a-z0-9]*_(?:voltage_v|displacement_um)\b", text)
    return len(axes_of_labels(labels)) > 1


def head_of(path: Path) -> str:
    """Return the beginning of a file, which contains the labels of a table."""
    with open(path, "rb") as file:
        head = file.read(HEAD_BYTES)
    if head.startswith(ZIP_MAGIC):
        with damage_reported(path, "NumPy file"), zipfile.ZipFile(path) as archive:
            head = " ".join(archive.namelist()).encode()
    return head.decode(errors="replace")


def read_axes(path: str | PathLike[str]) -> list[AxesRecording]:
    """Read the recordings of a file of several axes.

    Parameters
    ----------
    path : str or Path
        A recording of a stage of several axes, without the approach to the first sample of a
        waveform and the return from it; a table with columns such as ``time_s,x_voltage_v,
        y_voltage_v,x_displacement_um,y_displacement_um`` in any format that can be read for one
        axis; or the description of arrays (YAML), see `ArraysDocument`.

    Raises
    ------
    RecordingError
        If the file, a column, a row or the sample period is invalid; the message is one line.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = 1e-3 * np.arange(500)
    >>> push_v = np.random.default_rng(0).normal(size=(500, 2))
    >>> columns = {"time_s": time_s, "x_voltage_v": push_v[:, 0], "y_voltage_v": push_v[:, 1],
    ...            "x_displacement_um": 2.0 * push_v[:, 0], "y_displacement_um": 3.0 * push_v[:, 1]}
    >>> np.savetxt("axes.csv", np.column_stack(list(columns.values())), delimiter=",", comments="",
    ...            header=",".join(columns))
    >>> [each.axes for each in read_axes("axes.csv")]
    [('x', 'y')]
    """
    path = Path(path)
    if path.suffix.lower() in (".yaml", ".yml"):
        return _described(path)
    if holds_messages(path):
        return [axes_recording_of(read_recording(path, several_axes=True))]
    labels = [label for table in read_tables(path, lambda table: [], no_progress)
              for label in table.columns]
    return _joined(str(path), axes_of_labels(labels),
                   lambda columns: read_recordings(path, columns=columns))


def axes_recording_of(recording: Recording) -> AxesRecording:
    """Return what a stage of several axes played or tracked, from its first sample to the last.

    If the recording contains the number of repeats, and of those that settle, only the equal
    periods after these are returned. RecordingError is raised if samples are missing.
    """
    if not recording.axes:
        raise RecordingError(f"{recording.path} is of one axis: give a recording of several")
    played, part = np.flatnonzero(recording.playing | recording.tracking), recording
    if played.size:
        row = np.arange(len(recording.sample_index))
        part = recording.select((row >= played[0]) & (row <= played[-1]))
    if part.gaps:
        raise RecordingError(f"{recording.path} has gaps: record it again")
    settling, periods = _declared_repeats(recording.attachments)
    first, equal = 0, periods - settling
    if settling and not len(part.voltage_v) % periods:
        first = len(part.voltage_v) // periods * settling
    return _with_hash(AxesRecording(
        recording.path, recording.axes, part.sample_period_s, part.voltage_v[first:],
        part.displacement_um[first:], equal if first else 0, notes=tuple(recording.notes),
        columns={name: values[first:] for name, values in part.columns.items()},
        attachments=recording.attachments))


def _declared_repeats(attachments: Mapping[str, bytes]) -> tuple[int, int]:
    """Return the number of settling repeats, and of all repeats; 0 and 1 if they are unknown."""
    try:
        parameters = json.loads(attachments.get(PARAMETERS, b"{}"))
        return int(parameters.get("settling_repeats", 0)), int(parameters.get("repeats", 1))
    except (ValueError, TypeError, AttributeError):
        return 0, 1


def axes_recordings_in(data: Mapping[str, ArrayLike], name: str = IN_MEMORY) -> list[AxesRecording]:
    """Return the recordings in columns that are held in memory, by the labels of a table.

    Raises
    ------
    RecordingError
        If the columns are invalid, see `read_axes`.

    Examples
    --------
    >>> import numpy as np
    >>> time_s = 1e-3 * np.arange(500)
    >>> push_v = np.random.default_rng(0).normal(size=(500, 2))
    >>> columns = {"time_s": time_s, "x_voltage_v": push_v[:, 0], "y_voltage_v": push_v[:, 1],
    ...            "x_displacement_um": 2.0 * push_v[:, 0], "y_displacement_um": 3.0 * push_v[:, 1]}
    >>> recording, = axes_recordings_in(columns)
    >>> recording.axes
    ('x', 'y')
    """
    return _joined(name, axes_of_labels(list(data)),
                   lambda columns: recordings_in(data, columns, name))


def axes_recordings_of_arrays(
    voltage_v: ArrayLike, displacement_um: ArrayLike, sample_rate_hz: float, axes: Sequence[str],
    dimensions: Sequence[str] = ("sample", "channel"), signs: Sequence[float] = (),
    name: str = IN_MEMORY,
) -> list[AxesRecording]:
    """Return a recording for each realisation in arrays of samples, channels and so on.

    Parameters
    ----------
    voltage_v, displacement_um : array_like
        Arrays of the same shape.
    axes : sequence of str
        Names of the channels.
    dimensions : sequence of str
        "sample", "channel", "realisation" and "period" in the order of the arrays; missing ones
        have length 1. Periods are equal, and measured after the stage had settled.
    signs : sequence of float, optional
        Sign of the displacement of each channel.
    name : str
        Name in place of the path of a file.

    Raises
    ------
    RecordingError
        If the arrays do not match the dimensions and axes, or contain values that are not finite.

    Examples
    --------
    >>> import numpy as np
    >>> push_v = np.random.default_rng(0).normal(size=(3, 500, 2))
    >>> len(axes_recordings_of_arrays(push_v, 2.0 * push_v, 1000.0, ("x", "y"),
    ...                               ("realisation", "sample", "channel")))
    3
    """
    voltages_v, displacements_um = (np.asarray(each, dtype=float)
                                    for each in (voltage_v, displacement_um))
    if voltages_v.shape != displacements_um.shape or voltages_v.ndim != len(dimensions):
        raise RecordingError(
            f"{name}: the arrays have the shapes {voltages_v.shape} and {displacements_um.shape}: "
            f"give two of one shape with the dimensions {', '.join(dimensions)}")
    if not {"sample", "channel"} <= set(dimensions) or len(set(dimensions)) < len(dimensions):
        raise RecordingError(f"{name}: the dimensions are {', '.join(dimensions)}: give sample and "
                             "channel once, realisation and period at most once")
    channels = voltages_v.shape[list(dimensions).index("channel")]
    if channels != len(axes) or not 2 <= channels <= MOST_AXES:
        raise RecordingError(f"{name}: there are {channels} channels and {len(axes)} axes: give 2 "
                             f"to {MOST_AXES}, a name for each")
    displacements_um = _signed(displacements_um, signs, dimensions, name)
    if not (np.all(np.isfinite(voltages_v)) and np.all(np.isfinite(displacements_um))):
        raise RecordingError(
            f"{name} holds a number that is not finite: correct it or leave it out")
    return [
        _with_hash(AxesRecording(
            name, tuple(axes), 1.0 / sample_rate_hz, voltage, displacement,
            periods if "period" in dimensions else 0,
            str(number) if "realisation" in dimensions else ""))
        for number, (voltage, displacement, periods) in enumerate(zip(
            *(_by_realisation(each, dimensions) for each in (voltages_v, displacements_um)),
            _periods(voltages_v, dimensions), strict=True), start=1)]


def _periods(values: np.ndarray, dimensions: Sequence[str]) -> list[int]:
    size = dict(zip(dimensions, values.shape, strict=True))
    return [size.get("period", 1)] * size.get("realisation", 1)


def _by_realisation(values: np.ndarray, dimensions: Sequence[str]) -> np.ndarray:
    """Return an array of shape (realisations, samples of all periods in sequence, channels)."""
    order = ("realisation", "period", "sample", "channel")
    present = [each for each in order if each in dimensions]
    turned = np.transpose(values, [list(dimensions).index(each) for each in present])
    for axis, each in enumerate(order):
        if each not in dimensions:
            turned = np.expand_dims(turned, axis)
    realisations, periods, samples, channels = turned.shape
    return turned.reshape(realisations, periods * samples, channels)


def _described(path: Path) -> list[AxesRecording]:
    try:
        document = load_document(ArraysDocument, path)
    except SchemaError as error:
        raise RecordingError(f"{path}: {error}") from None
    found = axes_recordings_of_arrays(
        _array(path, document, "voltage"), _array(path, document, "displacement"),
        document.sample_rate_hz, document.axes, document.dimensions, name=str(path))
    wanted = document.realisations or [number + 1 for number in range(len(found))]
    if not set(wanted) <= set(range(1, len(found) + 1)):
        raise RecordingError(f"{path}: realisations names one that is not there: give numbers from "
                             f"1 to {len(found)}")
    return [found[int(number) - 1] for number in wanted]


def _array(path: Path, document: ArraysDocument, signal: str) -> np.ndarray:
    part: ChannelsPart = getattr(document, signal)
    file = path.parent / part.file
    if not file.is_file():
        raise RecordingError(f"{path} names {part.file}, which is missing: copy it there")
    with damage_reported(file, "NumPy file"):
        values = np.load(file).astype(float)
    return _signed(values, part.signs, document.dimensions, f"{path}: {signal}") * scale_of(
        signal, part.unit)


def _signed(values: np.ndarray, signs: Sequence[float], dimensions: Sequence[str],
            name: str) -> np.ndarray:
    """Multiply each channel by its sign."""
    if not len(signs):
        return values
    if values.ndim != len(dimensions) or "channel" not in dimensions:
        raise RecordingError(f"{name} has {values.ndim} dimensions: give as many names of "
                             "dimensions, one of them channel")
    where = list(dimensions).index("channel")
    if len(signs) != values.shape[where] or not np.all(signs):
        raise RecordingError(f"{name} has {len(signs)} signs: give one for each of "
                             f"{values.shape[where]} channels, none of them 0")
    return values * np.reshape(signs, [-1 if at == where else 1 for at in range(values.ndim)])


def _joined(name: str, axes: tuple[str, ...],
            read: Callable[[ColumnsDocument], list[Recording]]) -> list[AxesRecording]:
    """Read each axis as a separate recording, and join those with the same times."""
    if not 2 <= len(axes) <= MOST_AXES:
        raise RecordingError(
            f"{name} has {len(axes)} axes ({', '.join(axes) or 'none'}): give 2 to {MOST_AXES}, "
            "with columns such as x_voltage_v and x_displacement_um for each")
    by_axis = [read(ColumnsDocument(
        voltage=SignalColumn(column=f"{axis}_voltage_v", unit="V"),
        displacement=SignalColumn(column=f"{axis}_displacement_um", unit="um"))) for axis in axes]
    joined = []
    for parts in zip(*by_axis, strict=True):
        first = parts[0]
        if any(not np.array_equal(part.sample_index, first.sample_index) for part in parts):
            raise RecordingError(f"{name}: an axis has no values where another one has: give rows "
                                 "with values of all axes")
        if first.gaps:
            raise RecordingError(f"{name} has gaps: give the parts between the gaps as files of "
                                 "their own")
        joined.append(_with_hash(AxesRecording(
            name, axes, first.sample_period_s,
            np.column_stack([part.voltage_v for part in parts]),
            np.column_stack([part.displacement_um for part in parts]), title=first.title,
            notes=_joined_notes(axes, parts),
            columns={label: values for label, values in first.columns.items()
                     if label.partition("_")[0] not in axes})))
    return joined


def _joined_notes(axes: Sequence[str], parts: Sequence[Recording]) -> tuple[str, ...]:
    """Return each note once; notes that do not apply to all axes begin with the axis' name."""
    return tuple(dict.fromkeys(
        note if all(note in each.notes for each in parts) else f"axis {axis}: {note}"
        for axis, part in zip(axes, parts, strict=True) for note in part.notes))


def _with_hash(recording: AxesRecording) -> AxesRecording:
    return replace(recording, sha256=hash_of(recording.voltage_v, recording.displacement_um))
