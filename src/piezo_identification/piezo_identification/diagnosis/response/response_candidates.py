# SPDX-License-Identifier: BSD-3-Clause
"""The linear effects that may explain a frequency response, each fitted from a few guesses."""

from dataclasses import dataclass

import numpy as np

from piezo_identification.diagnosis.response.response_effect_fit import ResponseFit, ResponseProblem
from piezo_identification.diagnosis.response.response_measures import mean_square
from piezo_models.effects import Effect
from piezo_models.effects.creep import Creep
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode


@dataclass(frozen=True)
class GuessSettings:
    """Initial guesses of the effects."""

    modes: int = 27
    """Number of initial frequencies of a mode, so close that one is near any resonance in the
    range."""
    creep_relaxations: int = 3
    """Number of time constants of creep over the lower half of the range."""


SETTINGS = GuessSettings()


def fit_each_candidate(problem: ResponseProblem, current: ResponseFit) -> list[ResponseFit]:
    """Fit every candidate in addition to the effects found, the best on held-out data first."""
    found = {type(effect) for effect in current.effects}
    fits = []
    for kind, guesses in _guesses(problem).items():
        if kind in found and not kind.several:
            continue
        fitted = [problem.fit_last_effect(current, guess) for guess in guesses]
        best = min(fitted, key=lambda fit: mean_square(problem, fit, problem.estimation))
        fits.append(problem.fit_dynamics(best))
    return sorted(fits, key=lambda fit: mean_square(problem, fit))


def _guesses(problem: ResponseProblem) -> dict[type[Effect], list[Effect]]:
    """Return initial guesses of effects, by kind."""
    low_hz, high_hz = problem.measured.frequency_hz[[0, -1]]
    middle_hz, count = np.sqrt(low_hz * high_hz), SETTINGS.creep_relaxations
    slow_s = 1.0 / (2.0 * np.pi * np.geomspace(middle_hz, 0.3 * low_hz, count))
    return {
        Creep: [Creep((0.05,) * count, tuple(slow_s))],
        VibrationMode: [
            VibrationMode(2.0 * np.pi * frequency_hz, damping, 0.1)
            for frequency_hz in np.geomspace(*problem.mode_range_hz, SETTINGS.modes)
            for damping in (0.02, 0.2)],
        Delay: [Delay(delay_s) for delay_s in np.geomspace(0.01, 1.0, 4) / high_hz],
        SensorLag: [SensorLag(lag_s) for lag_s in np.geomspace(0.01, 1.0, 4) / high_hz],
    }
