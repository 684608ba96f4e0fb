# SPDX-License-Identifier: BSD-3-Clause
"""Whether the numbers of fitted dynamics can be those of a stage."""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.dynamics.fast_dynamics import ModeOrder, values_of
from piezo_identification.estimators.dynamics.fast_record import BESIDE_DAMPING
from piezo_identification.estimators.estimate import SIGNIFICANT, are_equal

LEAST_DAMPING = 5e-4
"""Damping ratio below which no mode of a structure lies that is glued or screwed together."""

HIGHEST = 0.9
"""Frequency over half the sample rate up to which samples tell a mode from its aliases."""

MOST_UNCERTAIN = 0.5
"""Standard deviation of the logarithm of a mode's frequency or damping beyond which it is not told:
of a mode that only stands in for a delay, no more than the ratio of both is."""

HEAVY_DAMPING, FAR_BELOW = 0.15, 0.05
"""Damping ratio, and frequency over that of the lowest mode which rings, of what creeps: structures
have no such modes, and what a hysteresis that is not quite right leaves looks like one."""


def lack_of_standing(
    vector: FloatArray, order: ModeOrder, covariance: FloatArray, sample_period_s: float,
) -> str:
    """Tell why fitted dynamics cannot be those of a stage.

    Parameters
    ----------
    vector : ndarray, shape (P,)
        Of `fast_dynamics.FastDynamics`.
    order : ModeOrder
    covariance : ndarray, shape (P, P) or larger
        Of the vector.
    sample_period_s : float

    Returns
    -------
    str
        Empty if nothing speaks against them.
    """
    values = values_of(vector, order)
    edges = np.cumsum([1, order.modes, order.modes, order.antiresonances, order.antiresonances,
                       order.beside, order.beside, order.sensor_lags])
    places = np.split(np.arange(vector.size), edges)
    _, w, zeta, wz, zetaz, side_w, side_zeta, lag, parts = places
    # Rounding may leave a variance a little below zero.
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    frequencies, dampings = np.concatenate([w, side_w]), np.concatenate([zeta, side_zeta])
    if np.any(values[frequencies] > HIGHEST * np.pi / sample_period_s):
        return "a mode above the band"
    if np.any(values[wz] > HIGHEST * np.pi / sample_period_s):
        return "an antiresonance above the band"
    if np.any(values[dampings] < LEAST_DAMPING) or np.any(
            values[side_zeta] < 1.01 * BESIDE_DAMPING[0]):
        return "a mode without damping"
    rings = values[dampings] < HEAVY_DAMPING
    slowest = values[frequencies][rings].min(initial=np.inf)
    if rings.any() and np.any(values[frequencies][~rings] < FAR_BELOW * slowest):
        return "a mode that creeps far below those that ring"
    if np.any(values[side_zeta] > 0.99 * BESIDE_DAMPING[1]):
        return "an overdamped mode beside others"
    if np.any(np.abs(values[parts]) < SIGNIFICANT * spread[parts]):
        return "a mode that moves nothing"
    if np.any(spread[np.concatenate([frequencies, dampings])] > MOST_UNCERTAIN):
        return "a mode that the data do not tell"
    if np.any(spread[lag] > 1.0 / SIGNIFICANT):
        return "a sensor's lag that the data do not tell"
    for mode, damping in zip(w, zeta, strict=True):
        for zero, its_damping in zip(wz, zetaz, strict=True):
            if all(are_equal(vector, covariance, *pair)
                   for pair in ((mode, zero), (damping, its_damping))):
                return "a mode that an antiresonance cancels"
    return ""
