# SPDX-License-Identifier: BSD-3-Clause
"""References to track, as the fields of ``piezo_interfaces/Reference``."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def harmonic(frequency_hz: float, amplitude_um: float, centre_um: float) -> dict[str, Any]:
    """Return a sine of one frequency, with its peak-to-peak amplitude and mean displacement."""
    return _of_components("harmonic", [frequency_hz], [amplitude_um], [], centre_um)


def triangle(frequency_hz: float, amplitude_um: float, centre_um: float) -> dict[str, Any]:
    """Return a triangle that consists of its harmonics up to 2 kHz; see `harmonic`."""
    return _of_components("triangle", [frequency_hz], [amplitude_um], [], centre_um)


def multi_frequency(frequencies_hz: Sequence[float], amplitudes_um: Sequence[float],
                    centre_um: float, phases_rad: Sequence[float] = ()) -> dict[str, Any]:
    """Return a sum of sines with peak-to-peak amplitudes, equation (4.21), about a mean.

    The phases are zero by default.
    """
    return _of_components("multi_frequency", frequencies_hz, amplitudes_um, phases_rad, centre_um)


def path(kind: str, rate_hz: float, size_um: float | Sequence[float],
         lines: int = 64) -> dict[str, Any]:
    """Return a path of several axes about the operating point of their model.

    The kind is ``raster``, ``spiral``, ``lissajous``, ``rosette`` or ``cycloid``. The rate is that
    of lines or turns a second, as for `piezo_controller.axes.patterns.ScanPattern`; the size that
    along the fast and the slow axis, or one for both; the lines are those of a frame, turns or
    lobes.
    """
    sizes_um = np.atleast_1d(np.asarray(size_um, dtype=float)).tolist()
    return {"kind": kind, "frequency_hz": [float(rate_hz)], "amplitude_um": sizes_um,
            "lines": lines}


def sampled(displacement_um: ArrayLike, path: str | PathLike[str],
            sample_rate_hz: float = 40000.0) -> dict[str, Any]:
    """Return a periodic trajectory given by the samples of one period.

    Parameters
    ----------
    displacement_um : array_like, shape (N,)
    path : path-like
        CSV file to write; the controller reads the period from it.
    sample_rate_hz : float
        Sample rate of the stage.

    Raises
    ------
    ValueError
        If the samples are not one sequence.
    """
    displacement_um = np.asarray(displacement_um, dtype=float)
    if displacement_um.ndim != 1:
        raise ValueError(f"the trajectory has {displacement_um.ndim} dimensions: "
                         "give one sequence of displacements")
    time_s = np.arange(len(displacement_um)) / sample_rate_hz
    path = Path(path).absolute()
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack([time_s, displacement_um]), fmt="%.12g", delimiter=",",
               header="time_s,displacement_um", comments="")
    return {"kind": "file", "file": str(path)}


def _of_components(kind: str, frequencies_hz: Sequence[float], amplitudes_um: Sequence[float],
                   phases_rad: Sequence[float], centre_um: float) -> dict[str, Any]:
    return {"kind": kind, "frequency_hz": [float(value) for value in frequencies_hz],
            "amplitude_um": [float(value) for value in amplitudes_um],
            "phase_rad": [float(value) for value in phases_rad], "centre_um": float(centre_um)}
