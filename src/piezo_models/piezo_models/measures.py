# SPDX-License-Identifier: BSD-3-Clause
"""Error measures of the thesis, in percent."""

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray


def e_rms_percent(reference_um: ArrayLike, displacement_um: ArrayLike,
                  remove_offset: bool = False) -> float:
    """Return the RMS tracking error in percent of the reference's peak-to-peak value, eq. (2.32).

    Parameters
    ----------
    reference_um, displacement_um : (N,) array_like
    remove_offset : bool
        Subtract the mean of the error first.

    Raises
    ------
    ValueError
        If the lengths differ, or the reference is empty or constant.

    Examples
    --------
    >>> round(e_rms_percent([0.0, 10.0, 20.0], [0.0, 10.0, 19.0]), 2)
    2.89
    """
    reference, displacement = _pair(reference_um, displacement_um)
    error = reference - displacement
    if remove_offset:
        error = error - error.mean()
    return _percent(float(np.sqrt(np.mean(error**2))), float(np.ptp(reference)))


def e_y_percent(measured_um: ArrayLike, estimated_um: ArrayLike,
                remove_offset: bool = True) -> float:
    """Return the norm of the model's error in percent of that of the measurement, eq. (4.20).

    Parameters
    ----------
    measured_um, estimated_um : (N,) array_like
    remove_offset : bool
        Subtract the mean of each signal first, as chapter 4 does.

    Raises
    ------
    ValueError
        If the lengths differ, or the measured displacement is empty or has no norm.

    Examples
    --------
    >>> round(e_y_percent([0.0, 10.0, 20.0], [1.0, 11.0, 20.0]), 2)
    5.77
    >>> round(e_y_percent([0.0, 10.0, 20.0], [1.0, 11.0, 20.0], remove_offset=False), 2)
    6.32
    """
    measured, estimated = _pair(measured_um, estimated_um)
    if remove_offset:
        measured, estimated = measured - measured.mean(), estimated - estimated.mean()
    return _percent(float(np.linalg.norm(measured - estimated)), float(np.linalg.norm(measured)))


def e_r_percent(reference_um: ArrayLike, displacement_um: ArrayLike,
                remove_offset: bool = True) -> float:
    """Return the norm of the tracking error in percent of that of the reference, eq. (4.23).

    This is `e_y_percent` of a reference and the displacement that followed it.

    Examples
    --------
    >>> round(e_r_percent([0.0, 10.0, 20.0], [1.0, 11.0, 20.0]), 2)
    5.77
    """
    return e_y_percent(reference_um, displacement_um, remove_offset)


def _pair(one: ArrayLike, other: ArrayLike) -> tuple[FloatArray, FloatArray]:
    first, second = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    if first.ndim != 1 or first.shape != second.shape or first.size == 0:
        raise ValueError(
            f"the signals have shapes {first.shape} and {second.shape}; "
            "give two sequences of one length"
        )
    return first, second


def _percent(error: float, scale: float) -> float:
    if scale == 0:
        raise ValueError("the signal to compare with is constant; give one that moves")
    return float(100 * error / scale)
