# SPDX-License-Identifier: BSD-3-Clause
"""Start of a larger order that makes what a fit of a smaller one makes."""

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.dynamics.fast_dynamics import ModeOrder, fast_dynamics_of
from piezo_identification.estimators.dynamics.fast_record import NEIGHBOURS, FastFit

IDLE, IDLE_DAMPING = 25.0, 0.1
"""Frequency over half the sample rate, and damping ratio, of a mode that adds nothing: it is at
rest within a sample period. It delays by a four-hundredth of it, which the delay makes up for."""

MIDDLE, MIDDLE_DAMPING = 0.3, np.exp(-1.0)
"""The same of a mode within the band that adds nothing, as an antiresonance cancels it or as no
part of the displacement is its."""

IDLE_LAG = 1e-2
"""Sensor's lag that adds nothing, in sample periods."""


def nested_start(
    smaller: FastFit, order: ModeOrder, sample_period_s: float,
) -> tuple[FloatArray, float]:
    """Return where an order makes what a smaller one makes.

    Parameters
    ----------
    smaller : FastFit
        Of an order that `order` holds.
    order : ModeOrder
    sample_period_s : float

    Returns
    -------
    vector : ndarray, shape (P,)
        Of `fast_dynamics.FastDynamics`.
    delay : float
        In sample periods.
    """
    model = fast_dynamics_of(smaller.vector, smaller.order)
    dynamics = model.dynamics
    w, zeta, wz, zetaz = (list(np.log(values)) for values in (
        dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios,
        dynamics.antiresonance_frequencies_rad_per_s, dynamics.antiresonance_damping_ratios))

    def frequency(part: float, place: int) -> float:
        return float(np.log(part * np.pi / sample_period_s) - place * NEIGHBOURS)

    for _ in range(min(order.modes - len(w), order.antiresonances - len(wz))):
        middle = frequency(MIDDLE, len(w))
        w.append(middle)
        wz.append(middle)
        zeta.append(np.log(MIDDLE_DAMPING))
        zetaz.append(np.log(MIDDLE_DAMPING))
    delay = smaller.delay - IDLE_LAG * (order.sensor_lags - smaller.order.sensor_lags)
    for sign, frequencies, dampings, count in (
            (-1.0, w, zeta, order.modes), (1.0, wz, zetaz, order.antiresonances)):
        while len(frequencies) < count:
            frequencies.append(frequency(IDLE, len(frequencies)))
            dampings.append(np.log(IDLE_DAMPING))
            delay += sign * 2.0 * IDLE_DAMPING / (np.exp(frequencies[-1]) * sample_period_s)
    further = range(smaller.order.beside, order.beside)
    lags = [model.sensor_lag_s] * smaller.order.sensor_lags
    lags += [IDLE_LAG * sample_period_s] * (order.sensor_lags - smaller.order.sensor_lags)
    return np.concatenate([
        [np.log(dynamics.time_constant_s)], w, zeta, wz, zetaz,
        np.log([mode.frequency_rad_per_s for mode in model.beside]),
        [frequency(MIDDLE, order.modes + place) for place in further],
        np.log([mode.damping_ratio for mode in model.beside]),
        [np.log(MIDDLE_DAMPING)] * len(further), np.log(lags),
        [mode.participation for mode in model.beside], [0.0] * len(further)]), delay
