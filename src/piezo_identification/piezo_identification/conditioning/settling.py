# SPDX-License-Identifier: BSD-3-Clause
"""What slow signals see of the electric and vibration dynamics."""

from collections.abc import Sequence

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.linear.dynamics import ElectricVibrationDynamics

NEGLIGIBLE = 1e-5
"""Part of a step below which what is left of its ringing does not count."""

MOST_OF_RECORDING = 0.25
"""Part of a recording that is given away to settle, however slowly a mode decays."""


def low_frequency_delay_s(dynamics: ElectricVibrationDynamics) -> float:
    """Return the delay of the dynamics at low frequency, the coefficient of (4.18) and (4.19).

    It is tau + sum 2 d / w over the modes, less the same sum over the antiresonances.

    Parameters
    ----------
    dynamics : ElectricVibrationDynamics

    Returns
    -------
    float
    """
    def sum_of_modes(frequencies: Sequence[float], dampings: Sequence[float]) -> float:
        return sum(2.0 * d / w for w, d in zip(frequencies, dampings, strict=True))

    return (
        dynamics.time_constant_s
        + sum_of_modes(dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios)
        - sum_of_modes(dynamics.antiresonance_frequencies_rad_per_s,
                       dynamics.antiresonance_damping_ratios)
    )


def settling_time_s(dynamics: ElectricVibrationDynamics) -> float:
    """Return the time after which the response to a step has decayed to its end value.

    Parameters
    ----------
    dynamics : ElectricVibrationDynamics

    Returns
    -------
    float
    """
    if dynamics.is_static:
        return 0.0
    slowest_rad_per_s = -dynamics.state_space().poles().real.max()
    return -np.log(NEGLIGIBLE) / slowest_rad_per_s


def first_settled(dynamics: ElectricVibrationDynamics, time_s: FloatArray) -> int:
    """Find the first sample of a recording at which its start has settled, if it is long enough.

    Parameters
    ----------
    dynamics : ElectricVibrationDynamics
    time_s : (N,) array
        Since the start.

    Returns
    -------
    int
    """
    settled = int(np.searchsorted(time_s, settling_time_s(dynamics)))
    return min(settled, int(MOST_OF_RECORDING * time_s.size))
