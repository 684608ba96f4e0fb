# SPDX-License-Identifier: BSD-3-Clause
"""Measured frequency responses and the CSV file that contains one."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.estimators.frequency_response.response_table import (
    is_response_table,
    read_response_table,
)


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
    """Return whether a text file contains a frequency response."""
    return Path(path).is_file() and is_response_table(Path(path))


def read_frequency_response(path: str | Path) -> FrequencyResponse:
    """Read a table with frequencies and gains; see `read_response_table` for its columns.

    Raises
    ------
    ValueError
        If the file cannot be read, lacks a column or its unit, or a row has no number.

    Examples
    --------
    >>> import numpy as np
    >>> np.savetxt("response.csv", [[10.0, 2.0, -0.1], [20.0, 1.9, -0.2]], delimiter=",",
    ...            comments="", header="frequency_hz,gain_re,gain_im")
    >>> print(read_frequency_response("response.csv").frequency_hz)
    [10. 20.]
    """
    if not Path(path).is_file():
        raise ValueError(f"{path} cannot be read: give an existing text file of a response")
    return FrequencyResponse(str(path), *read_response_table(Path(path)))
