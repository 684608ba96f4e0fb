# SPDX-License-Identifier: BSD-3-Clause
"""Vectors of a larger order that make the response of a smaller one."""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.frequency_response.response_model import ResponseOrder
from piezo_identification.estimators.frequency_response.response_standing import FASTEST

IDLE_DAMPING = 0.1
"""A mode far above the band begins with this damping ratio, which delays little."""

CANCELLED_DAMPING = 0.3
"""A mode upon which an antiresonance lies begins with this damping ratio."""


def holds(large: ResponseOrder, small: ResponseOrder) -> bool:
    """Tell whether every model of the smaller order is a limit of those of the larger one."""
    return large.beside == small.beside and all((one or 0) >= (other or 0) for one, other in (
        (large.creep_pairs, small.creep_pairs), (large.modes, small.modes),
        (large.antiresonances, small.antiresonances)))


def embedded(
    vector: FloatArray, small: ResponseOrder, large: ResponseOrder, rate_rad_per_s: FloatArray,
) -> FloatArray:
    """Return the vector of a larger order that makes what one of a smaller order makes.

    Further creep pairs cancel themselves; a further mode has an antiresonance upon it, or lies far
    above the band, as does a further antiresonance. Modes beside others are as many in both.

    Parameters
    ----------
    vector : ndarray, shape (P,)
        Delay, logarithms of gain, creep poles, creep zeros, lag, modes, dampings, antiresonances
        and their dampings; then frequencies, dampings and parts of modes beside others.
    small, large : ResponseOrder
    rate_rad_per_s : ndarray, shape (N,)
        Measured frequencies, increasing.

    Returns
    -------
    ndarray, shape (Q,)
    """
    pairs, modes, zeros = small.creep_pairs or 0, small.modes or 0, small.antiresonances or 0
    head, p, z, lag, w, zeta, wz, zetaz, beside = np.split(
        vector, np.cumsum([2, pairs, pairs, 1, modes, modes, zeros, zeros]))
    middle = np.sqrt(rate_rad_per_s[0] * rate_rad_per_s[-1])
    count = (large.creep_pairs or 0) - pairs
    creep = np.log(np.geomspace(rate_rad_per_s[0], middle, count + 2)[1:-1])
    further_modes = (large.modes or 0) - modes
    further_zeros = (large.antiresonances or 0) - zeros
    cancelled = min(further_modes, further_zeros)
    idle = np.log(0.9 * FASTEST * rate_rad_per_s[-1])

    def further(count: int) -> tuple[FloatArray, FloatArray]:
        frequencies = np.full(count, idle)
        dampings = np.full(count, np.log(IDLE_DAMPING))
        frequencies[:cancelled], dampings[:cancelled] = np.log(middle), np.log(CANCELLED_DAMPING)
        return frequencies, dampings

    (more_w, more_zeta), (more_wz, more_zetaz) = further(further_modes), further(further_zeros)
    return np.concatenate([
        head, p, creep, z, creep, lag, w, more_w, zeta, more_zeta, wz, more_wz, zetaz, more_zetaz,
        beside])
