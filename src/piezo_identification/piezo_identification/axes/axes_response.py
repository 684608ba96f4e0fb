# SPDX-License-Identifier: BSD-3-Clause
"""Measured frequency responses of two or three axes: of tables, arrays and python-control."""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Self

import control
import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.estimators.frequency_response.response_hold import hold_response
from piezo_recorder.reading.axes import MOST_AXES, head_of
from piezo_recorder.reading.tables.file_kinds import read_tables
from piezo_recorder.reading.tables.table import Table, no_progress
from piezo_recorder.sample_block import DEFAULT_SAMPLE_RATE_HZ

FREQUENCY = "frequency_hz"
LEAST_OVERSAMPLING = 10.0
"""Least sample rate over the highest frequency of a continuous response. The aliases of modes are
neglected, and are then less than 1e-3 of the response: they fall with the fourth power."""

_ENTRY = re.compile(r"\b([a-z][a-z0-9]*)_from_([a-z][a-z0-9]*)_gain(?:_re)?\b")
"""Label of the gain of an entry, with the axis that moves and the axis that is driven."""


@dataclass(frozen=True, eq=False)
class AxesResponse:
    """Measured response of every axis to the voltage of every axis.

    Raises
    ------
    ValueError
        If shapes, frequencies or numbers are invalid; the message is one line.

    Examples
    --------
    >>> import control
    >>> stage = control.append(control.tf(1, [1e-3, 1]), control.tf(2, [2e-3, 1]))
    >>> AxesResponse.from_control(control.frequency_response(stage, [1.0, 10.0, 100.0]))
    <AxesResponse response in memory: x, y at 3 frequencies from 0.159 to 15.9 Hz>
    """

    axes: tuple[str, ...]
    """Names, in the order of rows and columns."""
    frequency_hz: FloatArray
    """Positive and increasing, (K,)."""
    gain_um_per_v: ComplexArray
    """By frequency, moving axis and driven axis, (K, n, n)."""
    deviation_um_per_v: FloatArray | None = None
    """Standard deviation of each complex gain, the root of its mean square error, (K, n, n); by
    default a constant and a relative part are estimated from what the model leaves."""
    covariance_um2_per_v2: ComplexArray | None = None
    """In place of the deviations, if errors of different entries are correlated: the mean of each
    error times the conjugate of each, (K, n, n, n, n), by frequency, moving and driven axis of the
    first, and of the second."""
    sample_rate_hz: float = DEFAULT_SAMPLE_RATE_HZ
    """Sample rate of a model of the response."""
    is_held: bool = False
    """The gain is that from voltage samples, held at this rate, to displacement samples; else that
    of the stage between continuous signals."""
    name: str = "response in memory"
    """Path of the file that was read, or a name for messages."""

    def __post_init__(self) -> None:
        n, frequencies = len(self.axes), np.shape(self.frequency_hz)
        if not 2 <= n <= MOST_AXES:
            raise ValueError(f"{self.name} has {n} axes: give 2 to {MOST_AXES}")
        for part, entry in (("gain_um_per_v", (n, n)), ("deviation_um_per_v", (n, n)),
                            ("covariance_um2_per_v2", (n, n, n, n))):
            values = getattr(self, part)
            if values is not None and np.shape(values) != (*frequencies, *entry):
                raise ValueError(f"{self.name}: {part} has the shape {np.shape(values)} at "
                                 f"{frequencies} frequencies: give {(*frequencies, *entry)}")
        rising = np.diff(self.frequency_hz, prepend=0.0) > 0.0
        if not frequencies[0] or not rising.all() or not np.isfinite(self.frequency_hz[-1]):
            raise ValueError(f"{self.name}: the frequencies are not positive and rising: sort "
                             "them, each only once")
        self._check_entries(np.isfinite(self.gain_um_per_v), "gain that is finite")
        deviation = self.known_deviation()
        if deviation is not None:
            self._check_entries((0.0 < deviation) & (deviation < np.inf), "positive deviation")

    def _check_entries(self, valid: np.ndarray, what: str) -> None:
        wrong = np.argwhere(~valid)
        if len(wrong):
            row, moved, driven = wrong[0]
            raise ValueError(f"{self.name}: {self.axes[moved]} from {self.axes[driven]} has no "
                             f"{what} at {self.frequency_hz[row]:g} Hz: remove the frequency")

    def __repr__(self) -> str:
        return (f"<AxesResponse {self.name}: {', '.join(self.axes)} at {self.frequency_hz.size} "
                f"frequencies from {self.frequency_hz[0]:.3g} to {self.frequency_hz[-1]:.3g} Hz>")

    @property
    def sample_period_s(self) -> float:
        """Return the sample period of a model of the response."""
        return 1.0 / self.sample_rate_hz

    @property
    def sha256(self) -> str:
        """Return the hash of the frequencies and gains."""
        digest = hashlib.sha256()
        for values in (self.frequency_hz, self.gain_um_per_v):
            digest.update(np.ascontiguousarray(values).tobytes())
        return digest.hexdigest()

    def known_deviation(self) -> FloatArray | None:
        """Return the standard deviation of each gain in um/V, (K, n, n); None if not known."""
        if self.covariance_um2_per_v2 is None:
            return self.deviation_um_per_v
        deviation: FloatArray = np.sqrt(np.einsum("kijij->kij", self.covariance_um2_per_v2).real)
        return deviation

    def hold_gain(self) -> ComplexArray:
        """Return the gain from held samples to samples, relative to the measured one, (K,).

        Raises
        ------
        ValueError
            If the sample rate is too low for the frequencies.
        """
        least_hz = (2.0 if self.is_held else LEAST_OVERSAMPLING) * self.frequency_hz[-1]
        if not least_hz < self.sample_rate_hz < np.inf:
            raise ValueError(
                f"{self.name} goes up to {self.frequency_hz[-1]:g} Hz, which samples at "
                f"{self.sample_rate_hz:g} Hz do not show: give a rate above {least_hz:g} Hz")
        if self.is_held:
            return np.ones(self.frequency_hz.size, dtype=complex)
        return hold_response(self.frequency_hz, self.sample_period_s)

    @classmethod
    def from_control(cls, response: control.FrequencyResponseData, axes: Sequence[str] = (),
                     deviation_um_per_v: FloatArray | None = None) -> Self:
        """Return the response in an object of python-control, in um/V.

        Parameters
        ----------
        response : control.FrequencyResponseData
            With a sample period ``dt``, it is that between held samples.
        axes : sequence of str, optional
            x, y and z by default.
        deviation_um_per_v : (K, n, n) array, optional

        Raises
        ------
        ValueError
            If the response has not as many inputs as outputs, or is invalid otherwise.
        """
        outputs, inputs, _ = response.frdata.shape
        if outputs != inputs:
            raise ValueError(f"the response has {inputs} inputs and {outputs} outputs: give one of "
                             "each for every axis")
        held = {} if not response.dt or response.dt is True else {
            "sample_rate_hz": 1.0 / response.dt, "is_held": True}
        return cls(tuple(axes) or ("x", "y", "z")[:outputs], response.omega / (2.0 * np.pi),
                   np.moveaxis(response.frdata, 2, 0), deviation_um_per_v, **held)


def is_axes_response(path: str | PathLike[str]) -> bool:
    """Return whether a file contains a frequency response of several axes."""
    if not Path(path).is_file():
        return False
    head = head_of(Path(path))
    return FREQUENCY in head and len(_axes_of(head)) > 1


def read_axes_response(path: str | PathLike[str], sample_rate_hz: float = DEFAULT_SAMPLE_RATE_HZ,
                       is_held: bool = False) -> AxesResponse:
    """Read the frequency response of several axes.

    Parameters
    ----------
    path : str or Path
        Table with ``frequency_hz`` and for each entry, such as that of x from the voltage of y,
        ``x_from_y_gain_re`` and ``x_from_y_gain_im``, or ``x_from_y_gain`` and
        ``x_from_y_phase_deg``; and its standard deviation ``x_from_y_deviation``, if it is known.
        Gains and deviations are in um/V.
    sample_rate_hz, is_held
        As in `AxesResponse`.

    Raises
    ------
    ValueError
        If the file, a column or a row is invalid; the message is one line.

    Examples
    --------
    >>> entries = [f"{moved}_from_{driven}_gain_{part}"
    ...            for moved in "xy" for driven in "xy" for part in ("re", "im")]
    >>> np.savetxt("response.csv", [[10.0, *range(8)], [20.0, *range(8)]], delimiter=",",
    ...            comments="", header=",".join(["frequency_hz", *entries]))
    >>> read_axes_response("response.csv")
    <AxesResponse response.csv: x, y at 2 frequencies from 10 to 20 Hz>
    """
    tables = read_tables(Path(path), _needed, no_progress)
    table = next((each for each in tables if FREQUENCY in each.columns), tables[0])
    _needed(table)
    columns, axes = table.columns, _axes_of(" ".join(table.columns))
    entries = [f"{moved}_from_{driven}_" for moved in axes for driven in axes]
    shape = (-1, len(axes), len(axes))
    deviations = [columns[label] for entry in entries if (label := f"{entry}deviation") in columns]
    return AxesResponse(
        axes, columns[FREQUENCY],
        np.column_stack([_gain(columns, entry) for entry in entries]).reshape(shape),
        np.column_stack(deviations).reshape(shape) if deviations else None,
        sample_rate_hz=sample_rate_hz, is_held=is_held, name=str(path))


def _axes_of(text: str) -> tuple[str, ...]:
    """Return the names of the axes whose gains are among labels, in their order."""
    return tuple(dict.fromkeys(axis for entry in _ENTRY.findall(text) for axis in entry))


def _needed(table: Table) -> list[str]:
    """Return the columns of a response."""
    axes = _axes_of(" ".join(table.columns))
    needed, with_deviation = [FREQUENCY], any(
        label.endswith("_deviation") and "_from_" in label for label in table.columns)
    for entry in (f"{moved}_from_{driven}_" for moved in axes for driven in axes):
        is_polar = f"{entry}gain" in table.columns
        needed += [entry + part for part in (
            ("gain", "phase_deg") if is_polar else ("gain_re", "gain_im"))]
        needed += [f"{entry}deviation"] if with_deviation else []
    for label in needed:
        if label not in table.columns:
            raise ValueError(f"{table.path} has no column {label}: give {FREQUENCY} and the "
                             "columns of every axis from every axis")
    return needed


def _gain(columns: dict[str, np.ndarray], entry: str) -> ComplexArray:
    if f"{entry}gain" in columns:
        turned = np.exp(1j * np.radians(columns[f"{entry}phase_deg"]))
        return np.asarray(columns[f"{entry}gain"] * turned)
    return np.asarray(columns[f"{entry}gain_re"] + 1j * columns[f"{entry}gain_im"])
