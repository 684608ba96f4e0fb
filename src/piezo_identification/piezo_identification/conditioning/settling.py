# SPDX-License-Identifier: BSD-3-Clause
"""What slow signals see of the electric and vibration dynamics."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeGuard

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.delay import Delay
from piezo_models.effects.effect import Effect
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import ElectricVibrationDynamics, zoh

NEGLIGIBLE = 1e-5
"""Part of a step below which what is left of its ringing does not count."""

SMALL_PART = 0.01
"""Part of the displacement below which a mode beside others rings too little to wait for: it rings
about a mean that is right."""

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


def held_delay_s(dynamics: ElectricVibrationDynamics, sample_period_s: float) -> float:
    """Return the delay at low frequency from held voltages to samples read before they change.

    Of H(z) = C (zI - A)^-1 B + D, with the hold, it is -H'(1) periods. Half a period is added to
    `low_frequency_delay_s` where the dynamics are slow beside the period; where they are fast, the
    delay is a whole period.

    Parameters
    ----------
    dynamics : ElectricVibrationDynamics
    sample_period_s : float

    Returns
    -------
    float
    """
    system = zoh(dynamics.state_space(), sample_period_s)
    away = np.eye(system.nstates) - system.A
    slope = system.C @ np.linalg.solve(away, np.linalg.solve(away, system.B))
    return sample_period_s * float(slope[0, 0])


def slow_dynamics(
    dynamics: ElectricVibrationDynamics, effects: Sequence[Effect],
) -> ElectricVibrationDynamics:
    """Return the dynamics with all modes that have to settle among those in series.

    Parameters
    ----------
    dynamics : ElectricVibrationDynamics
    effects : sequence of Effect
        Of them, modes beside those of the dynamics are taken, unless their part is small.

    Returns
    -------
    ElectricVibrationDynamics
    """
    beside = [effect for effect in effects if _has_to_settle(effect)]
    return replace(
        dynamics,
        mode_frequencies_rad_per_s=dynamics.mode_frequencies_rad_per_s + tuple(
            mode.frequency_rad_per_s for mode in beside),
        damping_ratios=dynamics.damping_ratios + tuple(mode.damping_ratio for mode in beside))


def slow_delay_s(dynamics: ElectricVibrationDynamics, effects: Sequence[Effect]) -> float:
    """Return the delay of slow signals by dynamics and effects, beside that of `slow_dynamics`.

    Parameters
    ----------
    dynamics : ElectricVibrationDynamics
    effects : sequence of Effect
        Delays, lags of the amplifier or the sensor, and modes beside those of the dynamics, of
        which each delays its part of the displacement only.

    Returns
    -------
    float
    """
    in_series_s = low_frequency_delay_s(dynamics) - dynamics.time_constant_s
    delay_s = 0.0
    for effect in effects:
        if isinstance(effect, Delay):
            delay_s += effect.delay_s
        elif isinstance(effect, (SensorLag, AmplifierLag)):
            delay_s += effect.time_constant_s
        elif isinstance(effect, VibrationMode):
            own_s = 2.0 * effect.damping_ratio / effect.frequency_rad_per_s
            delay_s += effect.participation * (own_s - in_series_s)
            delay_s -= own_s if _has_to_settle(effect) else 0.0
    return delay_s


def _has_to_settle(effect: Effect) -> TypeGuard[VibrationMode]:
    return isinstance(effect, VibrationMode) and abs(effect.participation) > SMALL_PART


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
