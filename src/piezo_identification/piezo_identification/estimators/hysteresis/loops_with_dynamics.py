# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis of fast recordings, fitted together with the dynamics that follow it.

The hysteresis does not depend on frequency, which distinguishes it from the dynamics. For any
dynamics the best hysteresis follows from a regression, so that only the few parameters of the
dynamics are sought. Without a hysteresis, a slow mode would imitate it, and the search could not
recover. The dynamics are therefore extended one mode at a time, each starting where the residual
spectrum is largest.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.estimators.hysteresis.dynamics_inverse import held_response
from piezo_identification.estimators.hysteresis.fast_loops import (
    FastLoops,
    LoopFit,
    LoopRegression,
)
from piezo_models.hysteresis.pasts import PASTS, past_voltages
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import ElectricVibrationDynamics
from piezo_models.linear.dynamics_vector import dynamics_of_vector

REACH = 3.0
"""Largest change of the logarithms of the parameters, and of the delay in sample periods: the
parameters of an absent mode would grow without limit."""

MOST_MODES, LEAST_FALL = 3, 0.1
"""Largest number of modes, and the relative decrease of the squared error that each must give.
Further modes are found in the fit of the dynamics with this hysteresis."""

PEAKS = 3
"""Number of peaks in the spectrum of the residual at which a further mode is tried."""

TRIED_DAMPINGS = (0.01, 0.1, 0.8)
"""Initial damping ratios of a further mode."""

FOLLOWED = 2
"""Number of starts of a further mode, the best ones, that are refined."""

MOST_EVALUATIONS, LEAST_GAIN = 20, 1e-4
"""Number of steps of the search for the dynamics, and the smallest relative decrease of the squared
error in each. The result is only the input of a fit of the dynamics and their order."""

STEP = 1e-5
"""Step of the derivatives of a response: about the cube root of the precision."""


@dataclass(frozen=True, eq=False)
class LoopsWithDynamics:
    """A hysteresis and the dynamics that follow it."""

    hysteresis: PreisachModel
    """Hysteresis for the voltages of the recordings."""
    dynamics: ElectricVibrationDynamics

    delay_s: float
    """Delay in addition to the dynamics."""
    past: str
    """The one of `pasts.PASTS` that fits the recordings best."""

    def entering_um(self, recording: FastLoops) -> FloatArray:
        """Return the input of the dynamics in a recording, shape (N,)."""
        hysteresis, memory = self.hysteresis, self.hysteresis.memory()
        hysteresis.simulate(past_voltages(
            self.past, recording.voltage_v[0], hysteresis.voltage_min_v,
            hysteresis.voltage_max_v), memory)
        return hysteresis.simulate(recording.voltage_v, memory)


def hysteresis_with_dynamics(recordings: Sequence[FastLoops]) -> LoopsWithDynamics:
    """Fit a hysteresis of few cells, the dynamics behind it and a delay to rows of equal period."""
    period_s = recordings[0].sample_period_s
    regressions = [LoopRegression(recordings, past) for past in PASTS]
    start = _Point(np.array([np.log(period_s), 0.0]), 0, period_s)
    begun = LoopsWithDynamics(
        regressions[0].hysteresis(start.response), start.dynamics, 0.0, PASTS[0])
    if all(np.ptp(begun.entering_um(each)) == 0.0 for each in recordings):
        return begun  # no displacement rises with the voltage: there is nothing to follow
    lag = _polished(regressions[0], start)
    regression = min(regressions, key=lambda each: each.fit(lag.response).cost)
    found = _grown(regression, lag)
    return LoopsWithDynamics(
        regression.hysteresis(found.response), found.dynamics, found.delay * period_s,
        regression.past)


@dataclass(frozen=True, eq=False)
class _Point:
    """Parameters of dynamics during the search."""

    vector: FloatArray
    """Logarithms of the parameters of the dynamics, then the delay in sample periods, (P,)."""
    modes: int
    sample_period_s: float

    @property
    def dynamics(self) -> ElectricVibrationDynamics:
        """Dynamics at this point."""
        return dynamics_of_vector(np.exp(self.vector[:-1]), self.modes)

    @property
    def delay(self) -> float:
        """Delay in sample periods."""
        return float(self.vector[-1])

    def moved(self, vector: FloatArray) -> "_Point":
        """Return a point of the same order with another vector."""
        return _Point(vector, self.modes, self.sample_period_s)

    def with_mode(self, frequency_rad_per_s: float, damping: float, delay: float) -> "_Point":
        """Return a point with a further mode."""
        lag, frequencies, dampings, _ = np.split(
            self.vector, np.cumsum([1, self.modes, self.modes]))
        vector = np.concatenate([
            lag, frequencies, [np.log(frequency_rad_per_s)], dampings, [np.log(damping)], [delay]])
        return _Point(vector, self.modes + 1, self.sample_period_s)

    def response(self, frequency_hz: FloatArray) -> ComplexArray:
        """Response from held values to samples."""
        return held_response(self.dynamics, frequency_hz, self.sample_period_s,
                             self.delay * self.sample_period_s)

    def changes(self, frequency_hz: FloatArray) -> ComplexArray:
        """Return derivatives of the response by the vector, shape (P, F)."""
        return np.array([
            (self.moved(self.vector + step).response(frequency_hz)
             - self.moved(self.vector - step).response(frequency_hz)) / (2.0 * STEP)
            for step in STEP * np.eye(self.vector.size)])


def _grown(regression: LoopRegression, lag: _Point) -> _Point:
    """Start with a lag and a delay, and add modes as long as each reduces the error."""
    best = _polished(regression, lag)
    fit = regression.fit(best.response)
    for _ in range(MOST_MODES):
        starts = [best.with_mode(frequency, damping, delay)
                  for frequency in regression.peaks(fit, best.response, PEAKS)
                  for damping in TRIED_DAMPINGS for delay in {best.delay, 0.0}]
        starts.sort(key=lambda point: regression.fit(point.response).cost)
        refined = [_polished(regression, point) for point in starts[:FOLLOWED]]
        found = min(((regression.fit(point.response), point) for point in refined),
                    key=lambda each: each[0].cost, default=None)
        if found is None or found[0].cost > (1.0 - LEAST_FALL) * fit.cost:
            break
        fit, best = found
    return best


def _polished(regression: LoopRegression, start: _Point) -> _Point:
    """Refine a start to its smallest error."""
    fits: dict[bytes, LoopFit] = {}

    def fit_at(vector: FloatArray) -> LoopFit:
        if vector.tobytes() not in fits:
            fits.clear()
            fits[vector.tobytes()] = regression.fit(start.moved(vector).response)
        return fits[vector.tobytes()]

    solution = least_squares(
        lambda vector: fit_at(vector).residual, start.vector,
        lambda vector: regression.slopes(fit_at(vector), start.moved(vector).changes),
        bounds=(start.vector - REACH, start.vector + REACH), x_scale="jac", ftol=LEAST_GAIN,
        max_nfev=MOST_EVALUATIONS)
    return start.moved(solution.x)
