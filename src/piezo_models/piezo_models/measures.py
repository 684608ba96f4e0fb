# SPDX-License-Identifier: BSD-3-Clause
"""Error measures of the thesis, in percent."""

import numpy as np


def e_rms_percent(reference_um, displacement_um, remove_offset=False):
    """RMS of reference minus displacement over the reference's peak-to-peak value, eq. (2.32).

    Parameters
    ----------
    reference_um, displacement_um : (N,) array_like
    remove_offset : bool
        Take the mean of the error off first.

    Returns
    -------
    float
        Percent.

    Raises
    ------
    ValueError
        If the lengths differ, or the reference is empty or constant.
    """
    reference, displacement = _pair(reference_um, displacement_um)
    error = reference - displacement
    if remove_offset:
        error = error - error.mean()
    return _percent(np.sqrt(np.mean(error**2)), np.ptp(reference))


def e_y_percent(measured_um, estimated_um, remove_offset=True):
    """Norm of the model's error over the norm of the measured displacement, eq. (4.20).

    Parameters
    ----------
    measured_um, estimated_um : (N,) array_like
    remove_offset : bool
        Take each signal's mean off first, as chapter 4 does.

    Returns
    -------
    float
        Percent.

    Raises
    ------
    ValueError
        If the lengths differ, or the measured displacement is empty or has no norm.
    """
    return _norm_ratio_percent(measured_um, estimated_um, remove_offset)


def e_r_percent(reference_um, displacement_um, remove_offset=True):
    """Norm of the tracking error over the norm of the reference, eq. (4.23).

    Parameters
    ----------
    reference_um, displacement_um : (N,) array_like
    remove_offset : bool
        Take each signal's mean off first, as chapter 4 does.

    Returns
    -------
    float
        Percent.

    Raises
    ------
    ValueError
        If the lengths differ, or the reference is empty or has no norm.
    """
    return _norm_ratio_percent(reference_um, displacement_um, remove_offset)


def _norm_ratio_percent(truth, estimate, remove_offset):
    truth, estimate = _pair(truth, estimate)
    if remove_offset:
        truth, estimate = truth - truth.mean(), estimate - estimate.mean()
    return _percent(np.linalg.norm(truth - estimate), np.linalg.norm(truth))


def _pair(first, second):
    first, second = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    if first.ndim != 1 or first.shape != second.shape or first.size == 0:
        raise ValueError(
            f"the signals have shapes {first.shape} and {second.shape}; "
            "give two sequences of one length"
        )
    return first, second


def _percent(error, scale):
    if scale == 0:
        raise ValueError("the signal to compare with is constant; give one that moves")
    return float(100 * error / scale)
