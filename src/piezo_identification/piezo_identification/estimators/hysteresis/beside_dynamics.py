# SPDX-License-Identifier: BSD-3-Clause
"""The hysteresis of fast recordings, fitted together with the dynamics that follow it.

As the hysteresis depends on no frequency, what lags alike at all of them is told from what does
not: for any dynamics the best hysteresis is known, and only the few parameters of the dynamics are
sought. Without a hysteresis a slow mode would stand in for it, from which no search comes back; so
the dynamics grow behind it, mode after mode, each begun where the spectrum has most left.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.estimators.estimate import dynamics_of_vector
from piezo_identification.estimators.hysteresis.dynamics_inverse import held_response
from piezo_identification.estimators.hysteresis.fast_loops import (
    FastLoops,
    LoopFit,
    LoopRegression,
)
from piezo_models.hysteresis.pasts import PASTS, past_voltages
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import ElectricVibrationDynamics

REACH = 3.0
"""By so much the logarithms of the parameters, and the delay in sample periods, may change: a mode
that is not there would go on without end."""

MOST_MODES, LEAST_FALL = 3, 0.1
"""Modes that are sought, and the part by which each has to lower the squared error: more are left
to the fit of the dynamics behind the hysteresis that was found."""

PEAKS = 3
"""Peaks in the spectrum of what is left, at which a further mode is tried."""

TRIED_DAMPINGS = (0.01, 0.1, 0.8)
"""Damping ratios of a further mode to begin with."""

FOLLOWED = 2
"""So many of the starts of a further mode, the best ones, are followed."""

MOST_EVALUATIONS, LEAST_GAIN = 20, 1e-4
"""Steps of the search for the dynamics, and the part by which the squared error must fall in each:
what is found only drives a fit of the dynamics, and of their order."""

STEP = 1e-5
"""Step of the derivatives of a response: the third root of the rounding."""


@dataclass(frozen=True, eq=False)
class BesideDynamics:
    """A hysteresis and the dynamics behind it.

    Parameters
    ----------
    hysteresis : PreisachModel
        Over the voltages of the recordings.
    delay_s : float
        Beside them.
    past : str
        One of `pasts.PASTS`: that which explains the recordings best.
    """

    hysteresis: PreisachModel
    dynamics: ElectricVibrationDynamics
    delay_s: float
    past: str

    def entering_um(self, recording: FastLoops) -> FloatArray:
        """Return what enters the dynamics in a recording, shape (N,)."""
        hysteresis, memory = self.hysteresis, self.hysteresis.memory()
        hysteresis.simulate(past_voltages(
            self.past, recording.voltage_v[0], hysteresis.voltage_min_v,
            hysteresis.voltage_max_v), memory)
        return hysteresis.simulate(recording.voltage_v, memory)


def hysteresis_beside_dynamics(recordings: Sequence[FastLoops]) -> BesideDynamics:
    """Fit a hysteresis of few cells, the dynamics behind it and a delay together.

    Parameters
    ----------
    recordings : sequence of FastLoops
        Of one sample period.
    """
    period_s = recordings[0].sample_period_s
    regressions = [LoopRegression(recordings, past) for past in PASTS]
    start = _Point(np.array([np.log(period_s), 0.0]), 0, period_s)
    begun = BesideDynamics(regressions[0].hysteresis(start.response), start.dynamics, 0.0, PASTS[0])
    if all(np.ptp(begun.entering_um(each)) == 0.0 for each in recordings):
        return begun  # no displacement rises with the voltage: there is nothing to follow
    lag = _polished(regressions[0], start)
    regression = min(regressions, key=lambda each: each.fit(lag.response).cost)
    found = _grown(regression, lag)
    return BesideDynamics(
        regression.hysteresis(found.response), found.dynamics, found.delay * period_s,
        regression.past)


@dataclass(frozen=True, eq=False)
class _Point:
    """Parameters of dynamics as they are sought.

    Parameters
    ----------
    vector : ndarray, shape (P,)
        Logarithms of those of the dynamics, then the delay in sample periods.
    """

    vector: FloatArray
    modes: int
    sample_period_s: float

    @property
    def dynamics(self) -> ElectricVibrationDynamics:
        """The dynamics of this point."""
        return dynamics_of_vector(np.exp(self.vector[:-1]), self.modes)

    @property
    def delay(self) -> float:
        """In sample periods."""
        return float(self.vector[-1])

    def moved(self, vector: FloatArray) -> "_Point":
        """Return the point of the same order at another vector."""
        return _Point(vector, self.modes, self.sample_period_s)

    def with_mode(self, frequency_rad_per_s: float, damping: float, delay: float) -> "_Point":
        """Return the point with a further mode."""
        lag, frequencies, dampings, _ = np.split(
            self.vector, np.cumsum([1, self.modes, self.modes]))
        vector = np.concatenate([
            lag, frequencies, [np.log(frequency_rad_per_s)], dampings, [np.log(damping)], [delay]])
        return _Point(vector, self.modes + 1, self.sample_period_s)

    def response(self, frequency_hz: FloatArray) -> ComplexArray:
        """From held values to samples."""
        return held_response(self.dynamics, frequency_hz, self.sample_period_s,
                             self.delay * self.sample_period_s)

    def changes(self, frequency_hz: FloatArray) -> ComplexArray:
        """Return derivatives of the response by the vector, shape (P, F)."""
        return np.array([
            (self.moved(self.vector + step).response(frequency_hz)
             - self.moved(self.vector - step).response(frequency_hz)) / (2.0 * STEP)
            for step in STEP * np.eye(self.vector.size)])


def _grown(regression: LoopRegression, lag: _Point) -> _Point:
    """Begin with a lag and a delay, and add modes as long as each lowers the error."""
    best = _polished(regression, lag)
    fit = regression.fit(best.response)
    for _ in range(MOST_MODES):
        starts = [best.with_mode(frequency, damping, delay)
                  for frequency in regression.peaks(fit, best.response, PEAKS)
                  for damping in TRIED_DAMPINGS for delay in {best.delay, 0.0}]
        starts.sort(key=lambda point: regression.fit(point.response).cost)
        found = [_polished(regression, point) for point in starts[:FOLLOWED]]
        fits: list[tuple[float, int, LoopFit]] = []
        for place, point in enumerate(found):
            each = regression.fit(point.response)
            fits.append((each.cost, place, each))
        if not fits or min(fits)[0] > (1.0 - LEAST_FALL) * fit.cost:
            break
        _, place, fit = min(fits)
        best = found[place]
    return best


def _polished(regression: LoopRegression, start: _Point) -> _Point:
    """Follow a start to its least error."""
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
