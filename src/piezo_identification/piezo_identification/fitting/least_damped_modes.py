# SPDX-License-Identifier: BSD-3-Clause
"""A model with its least damped modes alone, and lags and a delay in place of the others."""

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.cascade import StageModel
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import ElectricVibrationDynamics

MUCH_MORE_DAMPED = 5.0
"""Ratio of damping to that of the least damped mode above which a mode may stand for a delay."""

FREQUENCIES, LOWEST = 200, 1e-3
"""Number of frequencies at which two responses are compared, and the lowest one relative to the
highest."""


def with_least_damped_modes(
    model: StageModel, delay_s: float, highest_rad_per_s: float,
) -> tuple[StageModel, float] | None:
    """Return a model with its least damped modes alone, and its delay in s; None if it has no more.

    The modes that remain make up the whole displacement. The electric lag, the sensor lags and the
    delay are those with which the response up to the highest frequency is nearest to that of the
    given model and delay. Models with antiresonances are left alone.
    """
    alone = _least_damped(model)
    return None if alone is None else _nearest(alone, model, delay_s, highest_rad_per_s)


def _least_damped(model: StageModel) -> StageModel | None:
    modes = [effect for effect in model.effects if isinstance(effect, VibrationMode)]
    others = [effect for effect in model.effects if not isinstance(effect, VibrationMode)]
    of_series = list(zip(model.dynamics.mode_frequencies_rad_per_s, model.dynamics.damping_ratios,
                         strict=True))
    dampings = [*(damping for _, damping in of_series), *(mode.damping_ratio for mode in modes)]
    most = MUCH_MORE_DAMPED * min(dampings, default=0.0)
    in_series = [(frequency, damping) for frequency, damping in of_series if damping <= most]
    in_parallel = [mode for mode in modes if mode.damping_ratio <= most]
    # Without modes in series, nothing moves at once.
    direct = 1.0 - sum(mode.participation for mode in modes) if in_series else 0.0
    whole = direct + sum(mode.participation for mode in in_parallel)
    if (len(in_series) + len(in_parallel) == len(dampings) or whole <= 0.0
            or model.dynamics.antiresonance_damping_ratios):
        return None
    if not in_series and len(in_parallel) == 1:
        in_series = [(in_parallel[0].frequency_rad_per_s, in_parallel[0].damping_ratio)]
        in_parallel = []
    return replace(
        model, effects=(*(VibrationMode.within_limits(
            mode.parameters() | {"participation": mode.participation / whole})
            for mode in in_parallel), *others),
        dynamics=ElectricVibrationDynamics(
            0.0, tuple(frequency for frequency, _ in in_series),
            tuple(damping for _, damping in in_series)))


def _nearest(model: StageModel, given: StageModel, delay_s: float,
             highest_rad_per_s: float) -> tuple[StageModel, float]:
    """Return a model with the lags and the delay whose response is nearest to a given one."""
    lags = [place for place, effect in enumerate(model.effects) if isinstance(effect, SensorLag)]
    s = np.asarray(1j * highest_rad_per_s * np.geomspace(LOWEST, 1.0, FREQUENCIES), dtype=complex)

    def with_numbers(numbers: FloatArray) -> tuple[StageModel, float]:
        electric_s, *lags_s = np.exp(numbers[:-1]).tolist()
        effects = list(model.effects)
        for place, lag_s in zip(lags, lags_s, strict=True):
            effects[place] = SensorLag(lag_s)
        return (replace(model, effects=tuple(effects),
                        dynamics=replace(model.dynamics, time_constant_s=electric_s)),
                float(numbers[-1] / highest_rad_per_s))

    target = _response(given, delay_s, s)

    def error(numbers: FloatArray) -> FloatArray:
        difference = _response(*with_numbers(numbers), s) - target
        return np.concatenate([difference.real, difference.imag])

    nearest = least_squares(
        error, [*np.full(1 + len(lags), -np.log(highest_rad_per_s)), 1.0]).x
    found, later_s = with_numbers(nearest)
    return found, max(later_s, 0.0)


def _response(model: StageModel, delay_s: float, s: ComplexArray) -> ComplexArray:
    """Return the response of linear part, sensor lags and delay at complex rates in rad/s, (n,)."""
    response = model.response(s.imag / (2.0 * np.pi)) * np.exp(-s * delay_s)
    for effect in model.effects:
        if isinstance(effect, SensorLag):
            response = response * effect.response(s)
    return np.asarray(response, dtype=complex)
