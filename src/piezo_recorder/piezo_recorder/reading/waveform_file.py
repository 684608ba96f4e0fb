# SPDX-License-Identifier: BSD-3-Clause
"""Read a voltage to play from a table of samples."""

import io
from pathlib import Path

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.regular_file import UnreadableFile, open_regular

LARGEST_BYTES = 1_000_000_000
"""Some minutes of the sample clock; a table without line ends is read at once."""

UNEVEN = 1e-3
"""Largest deviation of a row's instant, in sample periods; a table in microseconds rounds less."""


def read_waveform(path: Path) -> tuple[FloatArray, float]:
    """Read the columns ``time_s`` and ``voltage_v`` of a CSV file.

    Returns
    -------
    voltage_v : ndarray, shape (N,)
    sample_period_s : float

    Raises
    ------
    ValueError
        If it is no regular file of a bounded size, there are no such columns, fewer than two rows,
        or the rows are not uniform.
    """
    try:
        with open_regular(path, LARGEST_BYTES) as raw, io.TextIOWrapper(
                io.BufferedReader(raw), encoding="utf-8") as stream:
            table = np.genfromtxt(stream, delimiter=",", names=True)
    except UnreadableFile as error:
        raise ValueError(f"{path} {error}: give a CSV file with the columns "
                         "time_s,voltage_v") from None
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror}): "
                         "give a CSV file with the columns time_s,voltage_v") from None
    except ValueError as error:
        raise ValueError(f"{path} is no table of numbers: {str(error).splitlines()[0]}; give a "
                         "CSV file with the columns time_s,voltage_v") from None
    for name in ("time_s", "voltage_v"):
        if name not in (table.dtype.names or ()):
            raise ValueError(f"{path} has no column {name}: give a CSV file with the columns "
                             "time_s,voltage_v")
    time_s, voltage_v = np.atleast_1d(table["time_s"]), np.atleast_1d(table["voltage_v"])
    if time_s.size < 2 or not np.isfinite([time_s, voltage_v]).all():
        raise ValueError(f"{path} needs two rows or more, with a number in each field: complete it")
    period_s = float((time_s[-1] - time_s[0]) / (time_s.size - 1))
    uniform_s = time_s[0] + period_s * np.arange(time_s.size)
    if period_s <= 0.0 or np.abs(time_s - uniform_s).max() > UNEVEN * period_s:
        raise ValueError(f"{path} is not sampled uniformly: give its rows at equal intervals")
    return voltage_v, float(f"{period_s:.9g}")
