# SPDX-License-Identifier: BSD-3-Clause
"""Whether the numbers of a model of a frequency response can be those of a stage."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.estimate import SIGNIFICANT, are_equal
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
        Delay, and the logarithms of the other parameters; then the parts of modes side by side.
    order : ResponseOrder
    covariance : ndarray, shape (P, P)
    highest_rad_per_s : float
        Highest frequency that was measured.

    Returns
    -------
    str
        Empty if nothing speaks against it.
    """
    parts = _places(vector.size, order)
    if np.any(np.exp(vector[[*parts.w, *parts.side_w]]) > HIGHEST * highest_rad_per_s):
        return "a mode above the band"
    if np.any(np.exp(vector[parts.wz]) > HIGHEST * highest_rad_per_s):
        return "an antiresonance above the band"
    if np.any(np.exp(vector[[*parts.zeta, *parts.side_zeta]]) < LEAST_DAMPING):
        return "a mode without damping"
    if np.any(_moves_nothing(vector, parts, covariance)):
        return "a mode that moves nothing"
    for mode, damping in zip(parts.w, parts.zeta, strict=True):
        for zero, its_damping in zip(parts.wz, parts.zetaz, strict=True):
            pairs = ((mode, zero), (damping, its_damping))
            if all(are_equal(vector, covariance, *pair) for pair in pairs):
                return "a mode that an antiresonance cancels"
    return ""


def without_idle(
    vector: FloatArray, order: ResponseOrder, covariance: FloatArray, highest_rad_per_s: float,
) -> tuple[FloatArray, ResponseOrder]:
    """Leave out modes and antiresonances above the band, and modes beside that move nothing.

    Parameters
    ----------
    vector, order, covariance, highest_rad_per_s
        As of `lack_of_standing`.

    Returns
    -------
    vector : ndarray, shape (Q,)
        From which a fit of the smaller order may begin.
    order : ResponseOrder
        The given one where nothing is idle, or it would have more antiresonances than modes.
    """
    parts = _places(vector.size, order)

    def above(places: NDArray[np.intp]) -> NDArray[np.bool_]:
        return np.exp(vector[places]) > HIGHEST * highest_rad_per_s

    mode, zero = above(parts.w), above(parts.wz)
    side = above(parts.side_w) | _moves_nothing(vector, parts, covariance)
    smaller = replace(
        order, modes=int(np.sum(~mode)), antiresonances=int(np.sum(~zero)),
        beside=int(np.sum(~side)))
    if (smaller.antiresonances or 0) > (smaller.modes or 0) or not smaller.modes:
        return vector, order
    kept = np.concatenate([
        parts.head, *(places[~idle] for places, idle in (
            (parts.w, mode), (parts.zeta, mode), (parts.wz, zero), (parts.zetaz, zero),
            (parts.side_w, side), (parts.side_zeta, side), (parts.participation, side)))])
    return vector[kept], smaller


class _Places(NamedTuple):
    """Where the numbers of each kind stand in a vector."""

    head: NDArray[np.intp]
    w: NDArray[np.intp]
    zeta: NDArray[np.intp]
    wz: NDArray[np.intp]
    zetaz: NDArray[np.intp]
    side_w: NDArray[np.intp]
    side_zeta: NDArray[np.intp]
    participation: NDArray[np.intp]


def _places(size: int, order: ResponseOrder) -> _Places:
    modes, zeros = order.modes or 0, order.antiresonances or 0
    first = 3 + 2 * (order.creep_pairs or 0)
    return _Places(*np.split(np.arange(size), np.cumsum(
        [first, modes, modes, zeros, zeros, order.beside, order.beside])))


def _moves_nothing(
    vector: FloatArray, parts: _Places, covariance: FloatArray,
) -> NDArray[np.bool_]:
    """Mark the modes beside others whose part is none as far as the data tell."""
    spread = np.sqrt(np.diag(covariance)[parts.participation])
    return np.abs(vector[parts.participation]) < SIGNIFICANT * spread
