# SPDX-License-Identifier: BSD-3-Clause
"""Samples that the sensor got wrong, and recordings mended of them."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import convolve1d, maximum_filter1d, median_filter

from piezo_models.effects.outliers import AROUND, FEWEST, NEIGHBOURS, THRESHOLD

JUMP, AFTER_JUMP = 0.05, 40
"""Part of the voltage's span that is a jump, and samples in which it is badly predicted."""

BETWEEN = np.array([-1.0, 4.0, 0.0, 4.0, -1.0]) / 6.0
"""Of a cubic through two samples on either side of one: its value there."""
BESIDE = BETWEEN.size // 2

SMALL = 1e-4
"""Part of the travel that counts as noise, at least: the step of a converter may be as large."""

MOST_ROUNDS = 10


def jumps_of(voltage_v):
    """Mask of the samples before which the voltage jumps.

    Parameters
    ----------
    voltage_v : (N,) array

    Returns
    -------
    (N,) array of bool
    """
    return np.abs(np.diff(voltage_v, prepend=voltage_v[0])) > JUMP * np.ptp(voltage_v)


def answers_a_jump(voltage_v):
    """Mask of the samples in which the residual after a jump may look like outliers.

    Parameters
    ----------
    voltage_v : (N,) array

    Returns
    -------
    (N,) array of bool
    """
    jumps = jumps_of(voltage_v)
    return np.convolve(jumps, np.ones(AFTER_JUMP))[: jumps.size] > 0.0


def without_outliers(recording):
    """The recording with its outliers on smooth curves through the samples beside them.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    recording : Recording
        The given one if there are no more than chance makes.
    count : int
        Of the samples changed.
    """
    measured_um = np.asarray(recording.displacement_um, dtype=float)
    jumps = jumps_of(recording.voltage_v)
    # The samples beside a jump are compared with some on its other side.
    sharp = maximum_filter1d(jumps, 2 * BESIDE + 1)
    mended_um = measured_um.copy()
    for _ in range(MOST_ROUNDS):
        expected_um = convolve1d(mended_um, BETWEEN, mode="nearest")
        wrong = _far_off(mended_um, expected_um, SMALL * np.ptp(measured_um)) & ~sharp
        if not wrong.any():
            break
        mended_um[wrong] = expected_um[wrong]
    count = int(np.count_nonzero(mended_um != measured_um))
    if count < FEWEST:
        return recording, 0
    return replace(recording, displacement_um=mended_um), count


def _far_off(measured_um, expected_um, noise_um):
    """Mask of samples farther off than noise makes; of neighbours the worst: it spoils theirs."""
    off_um = np.abs(measured_um - expected_um)
    around_um = 1.4826 * median_filter(off_um, AROUND, mode="nearest")
    limit_um = THRESHOLD * np.maximum(noise_um, around_um)
    # A good sample between two wrong ones is not far off the others.
    off_um[np.abs(measured_um - median_filter(measured_um, NEIGHBOURS)) < limit_um] = 0.0
    return (off_um > limit_um) & (off_um == maximum_filter1d(off_um, 2 * BESIDE + 1))
