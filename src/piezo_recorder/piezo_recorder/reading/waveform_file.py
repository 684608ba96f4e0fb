# SPDX-License-Identifier: BSD-3-Clause
"""Reader of a voltage to play from a table of samples."""

import io
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_common.regular_file import UnreadableFile, open_regular
from piezo_recorder.reading.axes import axes_with_voltage
from piezo_recorder.reading.detected import marks_in

LARGEST_BYTES = 1_000_000_000
"""Largest size, some minutes of the sample clock; a table without line ends is read at once."""

UNEVEN = 1e-3
"""Largest deviation of a row's time, in sample periods; times in microseconds round less."""


class StoredWaveform(NamedTuple):
    """A voltage to play."""

    voltage_v: FloatArray
    """Shape (N,) or (N, axes)."""
    sample_period_s: float

    axes: tuple[str, ...] = ()
    """Names of several axes."""
    marks: NDArray[np.uint8] = np.empty(0, np.uint8)
    """Marks of the samples, (N,); empty if the table has none."""


def read_waveform(path: Path) -> StoredWaveform:
    """Read ``time_s`` and ``voltage_v``, or those of several axes, and marks from a CSV file.

    ValueError is raised if it is not a regular file of bounded size, lacks the columns, has fewer
    than two rows, or is not sampled uniformly.
    """
    try:
        with open_regular(path, LARGEST_BYTES) as raw, io.TextIOWrapper(
                io.BufferedReader(raw), encoding="utf-8") as stream, warnings.catch_warnings(
                action="error"):  # NumPy only warns of an empty file
            table = np.genfromtxt(stream, delimiter=",", names=True)
    except UnreadableFile as error:
        raise ValueError(f"{path} {error}: give a CSV file with the columns "
                         "time_s,voltage_v") from None
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror}): "
                         "give a CSV file with the columns time_s,voltage_v") from None
    except (ValueError, Warning):
        raise ValueError(f"{path} is no table of numbers between commas: give a CSV file with the "
                         "columns time_s,voltage_v") from None
    labels = table.dtype.names or ()
    axes = axes_with_voltage(labels)
    voltages = [f"{axis}_voltage_v" for axis in axes] or ["voltage_v"]
    for name in ("time_s", *voltages):
        if name not in labels:
            raise ValueError(f"{path} has no column {name}: give a CSV file with the columns "
                             "time_s,voltage_v")
    time_s, *by_axis = (np.atleast_1d(table[name]) for name in ("time_s", *voltages))
    if time_s.size < 2 or not np.isfinite([time_s, *by_axis]).all():
        raise ValueError(f"{path} needs two rows or more, with a number in each field: complete it")
    period_s = float((time_s[-1] - time_s[0]) / (time_s.size - 1))
    uniform_s = time_s[0] + period_s * np.arange(time_s.size)
    if period_s <= 0.0 or np.abs(time_s - uniform_s).max() > UNEVEN * period_s:
        raise ValueError(f"{path} is not sampled uniformly: give its rows at equal intervals")
    return StoredWaveform(np.column_stack(by_axis) if axes else by_axis[0],
                          float(f"{period_s:.9g}"), axes,
                          marks_in({label: np.atleast_1d(table[label]) for label in labels}))
