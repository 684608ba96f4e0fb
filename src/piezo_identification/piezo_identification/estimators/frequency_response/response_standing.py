# SPDX-License-Identifier: BSD-3-Clause
"""Whether the numbers of a model of a frequency response can be those of a stage."""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.estimate import are_equal
from piezo_identification.estimators.frequency_response.response_model import ResponseOrder

FASTEST = 30.0
"""Frequency over the highest measured one up to which a mode may go: from there on it is as if it
were not there."""

HIGHEST = 1.1
"""Frequency over the highest measured one up to which a response tells a mode."""

LEAST_DAMPING = 2e-4
"""Damping ratio below which no mode of a structure lies that is glued or screwed together."""


def lack_of_standing(
    vector: FloatArray, order: ResponseOrder, covariance: FloatArray, highest_rad_per_s: float,
) -> str:
    """Tell why a fitted model cannot be that of a stage.

    Parameters
    ----------
    vector : ndarray, shape (P,)
        Delay, and the logarithms of the other parameters.
    order : ResponseOrder
    covariance : ndarray, shape (P, P)
    highest_rad_per_s : float
        Highest frequency that was measured.

    Returns
    -------
    str
        Empty if nothing speaks against it.
    """
    modes, zeros = order.modes or 0, order.antiresonances or 0
    first = 3 + 2 * (order.creep_pairs or 0)
    _, w, zeta, wz, zetaz = np.split(
        np.arange(vector.size), np.cumsum([first, modes, modes, zeros]))
    if np.any(np.exp(vector[w]) > HIGHEST * highest_rad_per_s):
        return "a mode above the band"
    if np.any(np.exp(vector[wz]) > HIGHEST * highest_rad_per_s):
        return "an antiresonance above the band"
    if np.any(np.exp(vector[zeta]) < LEAST_DAMPING):
        return "a mode without damping"
    for mode, damping in zip(w, zeta, strict=True):
        for zero, its_damping in zip(wz, zetaz, strict=True):
            pairs = ((mode, zero), (damping, its_damping))
            if all(are_equal(vector, covariance, *pair) for pair in pairs):
                return "a mode that an antiresonance cancels"
    return ""
