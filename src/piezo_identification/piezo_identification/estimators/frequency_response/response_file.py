# SPDX-License-Identifier: BSD-3-Clause
"""Measured frequency responses and the CSV file that contains one."""

import csv
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.estimators.frequency_response.response_table import (
    is_response_table,
    read_response_table,
)

COLUMNS = ("frequency_hz", "gain_re", "gain_im")


@dataclass(frozen=True)
class FrequencyResponse:
    """Complex gain at a number of frequencies."""

    path: str
    """Path of the file it was read from."""
    frequency_hz: FloatArray = field(repr=False)
    """Positive and increasing, (N,)."""
    gain: ComplexArray = field(repr=False)
    """Displacement over voltage, in the unit in which it was measured, (N,)."""
    hold_s: float = 0.0
    """Sample period, if the gain is that from held voltage samples (zero-order hold) to
    displacement samples; 0 if it is that of the stage between continuous signals."""

    def held(self, hold_s: float) -> "FrequencyResponse":
        """Return the response, declared as one from held samples to samples.

        Parameters
        ----------
        hold_s : float
            Sample period; 0 for no hold.

        Raises
        ------
        ValueError
            If a frequency is not below half the rate of such samples.
        """
        if self.frequency_hz[-1] * hold_s >= 0.5:
            raise ValueError(
                f"{self.path} goes up to {self.frequency_hz[-1]:g} Hz, but samples at "
                f"{1.0 / hold_s:g} Hz show only what is below half of that: give the rate at "
                "which the voltage was held"
            )
        return replace(self, hold_s=hold_s)

    def between(self, lowest_hz: float, highest_hz: float) -> "FrequencyResponse":
        """Part of the response, both ends included.

        Raises
        ------
        ValueError
            If no frequency lies in the band.
        """
        part = (self.frequency_hz >= lowest_hz) & (self.frequency_hz <= highest_hz)
        if not part.any():
            raise ValueError(
                f"{self.path} has no frequency from {lowest_hz:g} to {highest_hz:g} Hz: it covers "
                f"{self.frequency_hz[0]:g} to {self.frequency_hz[-1]:g} Hz"
            )
        return replace(self, frequency_hz=self.frequency_hz[part], gain=self.gain[part])


def is_frequency_response(path: str | Path) -> bool:
    """Return whether a file contains a frequency response, in this or another program's format."""
    return Path(path).is_file() and (_is_ours(path) or is_response_table(Path(path)))


def _is_ours(path: str | Path) -> bool:
    """Whether a file's first line names the columns of a frequency response."""
    try:
        with Path(path).open(encoding="utf-8-sig") as file:
            return COLUMNS[0] in file.readline()
    except (OSError, UnicodeDecodeError):
        return False


def read_frequency_response(path: str | Path) -> FrequencyResponse:
    """Read a CSV file with the columns frequency_hz, gain_re and gain_im.

    Parameters
    ----------
    path : path-like
        CSV file, or text file of another program; see `read_response_table`.

    Raises
    ------
    ValueError
        If the file cannot be read, lacks a column, or a row has no finite gain at a frequency
        above that of the row before; the message names the row.

    Examples
    --------
    >>> import numpy as np
    >>> np.savetxt("response.csv", [[10.0, 2.0, -0.1], [20.0, 1.9, -0.2]], delimiter=",",
    ...            comments="", header="frequency_hz,gain_re,gain_im")
    >>> print(read_frequency_response("response.csv").frequency_hz)
    [10. 20.]
    """
    if not _is_ours(path) and is_frequency_response(path):
        return FrequencyResponse(str(path), *read_response_table(Path(path)))
    try:
        with Path(path).open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.reader(file))
    except OSError as error:
        raise ValueError(
            f"{path} cannot be read ({error.strerror}): give an existing CSV file"
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path} is no text with commas: give a CSV file") from error
    header = [name.strip() for name in rows[0]] if rows else []
    for name in COLUMNS:
        if name not in header:
            raise ValueError(
                f"{path} has no column {name}: its first line must name {', '.join(COLUMNS)}"
            )
    places = [header.index(name) for name in COLUMNS]
    values, before = [], 0.0
    for number, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            entry = [float(row[place]) for place in places]
        except (ValueError, IndexError):
            raise ValueError(
                f"{path}, line {number}: a number is missing or cannot be read: correct or remove "
                "the line"
            ) from None
        if not np.isfinite(entry).all():
            raise ValueError(f"{path}, line {number}: not a finite number: remove the line")
        if entry[0] <= before:
            raise ValueError(
                f"{path}, line {number}: frequency {entry[0]:g} Hz does not exceed {before:g} Hz: "
                "sort the lines by frequency, each positive and only once"
            )
        before = entry[0]
        values.append(entry)
    if not values:
        raise ValueError(f"{path} has no line of data: measure again")
    frequency_hz, real, imaginary = np.array(values).T
    return FrequencyResponse(str(path), frequency_hz, real + 1j * imaginary)
