# SPDX-License-Identifier: BSD-3-Clause
"""The hysteresis of fast recordings, fitted together with the dynamics that follow it.

What leaves the dynamics is linear in the Everett values of the hysteresis. So for any dynamics the
hysteresis of least error is that of a linear regression, and only the few parameters of the
dynamics are sought: variable projection (Golub and Pereyra 1973). As the hysteresis depends on no
frequency, what lags alike at all of them is told from what does not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft
from scipy.optimize import least_squares
from scipy.sparse import csr_array

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_identification.estimators.estimate import dynamics_of_vector, dynamics_vector
from piezo_identification.estimators.hysteresis.density_estimate import lower_triangle
from piezo_identification.estimators.hysteresis.dynamics_inverse import (
    closed_signal,
    held_response,
    samples_added,
)
from piezo_identification.estimators.hysteresis.equations import bending_operator
from piezo_identification.estimators.hysteresis.everett_regression import everett_regression
from piezo_identification.estimators.hysteresis.nonnegative import nonnegative_minimum
from piezo_identification.estimators.hysteresis.penalties import bounded_operator
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import ElectricVibrationDynamics

CELLS = 12
"""Cells along a threshold: enough for the hysteresis that drives dynamics, few enough to filter."""

SMOOTHING = 1e-10
"""Weight of the density's curvature."""

MOST_SAMPLES = 40_000
"""Samples of the longest recordings that are fitted; further ones would only cost time."""

LEAST = 1e-3
"""A lag that is shorter than this part of a sample period starts from it, as logarithms need."""

REACH = 3.0
"""By so much the logarithms of the parameters, and the delay in sample periods, may change: a mode
that is not there would go on without end."""

MOST_ROWS = 6_000
"""Samples that are compared, spread over all: many times as many as there are unknowns."""

MOST_EVALUATIONS, LEAST_GAIN = 15, 1e-4
"""Steps of the search for the dynamics, and the part by which the squared error must fall in each:
what is found only drives a fit of the dynamics, and of their order."""


@dataclass(frozen=True, eq=False)
class FastLoops:
    """A fast recording without gaps, and what else its displacement may hold.

    Parameters
    ----------
    voltage_v, displacement_um : ndarray, shape (N,)
        The creep is removed from the displacement.
    fixed : ndarray, shape (N, K)
        Columns whose coefficients are free, such as an offset.
    first_kept : int
        Sample from which on the past counts for no more than these columns.
    sample_period_s : float
    """

    voltage_v: FloatArray
    displacement_um: FloatArray
    fixed: FloatArray
    first_kept: int
    sample_period_s: float

    def first(self, count: int) -> "FastLoops":
        """Return the first samples alone."""
        return FastLoops(self.voltage_v[:count], self.displacement_um[:count],
                         self.fixed[:count], self.first_kept, self.sample_period_s)


def hysteresis_beside_dynamics(
    recordings: Sequence[FastLoops], dynamics: ElectricVibrationDynamics, delay_s: float = 0.0,
) -> tuple[PreisachModel, ElectricVibrationDynamics]:
    """Fit a hysteresis of few cells, the dynamics behind it and a delay together.

    Parameters
    ----------
    recordings : sequence of FastLoops
        Of one sample period.
    dynamics : ElectricVibrationDynamics
        From which the search begins; their order stays.
    delay_s : float
        Of the displacement beside the dynamics, from which the search begins.

    Returns
    -------
    hysteresis : PreisachModel
        Over the voltages of the recordings.
    dynamics : ElectricVibrationDynamics
    """
    problem = _Problem(recordings)
    period_s = recordings[0].sample_period_s
    modes = len(dynamics.mode_frequencies_rad_per_s)
    zeros = len(dynamics.antiresonance_frequencies_rad_per_s)

    def of_point(point: FloatArray) -> tuple[ElectricVibrationDynamics, float]:
        return dynamics_of_vector(np.exp(point[:-1]), modes, zeros), float(point[-1]) * period_s

    positive = np.maximum(dynamics_vector(dynamics), LEAST * period_s)
    start = np.append(np.log(positive), delay_s / period_s)
    solution = least_squares(
        lambda point: problem.residual(*of_point(point)), start,
        bounds=(start - REACH, start + REACH), x_scale="jac", ftol=LEAST_GAIN,
        max_nfev=MOST_EVALUATIONS)
    best, delay_s = of_point(solution.x)
    return problem.hysteresis(best, delay_s), best


class _Problem:
    """Regression of what is measured on the responses to the Everett values of all recordings."""

    def __init__(self, recordings: Sequence[FastLoops]) -> None:
        low_v = min(float(part.voltage_v.min()) for part in recordings)
        high_v = max(float(part.voltage_v.max()) for part in recordings)
        self._levels_v = np.linspace(low_v, high_v, CELLS + 1)
        most = MOST_SAMPLES // len(recordings)
        self._parts = [part.first(part.first_kept + most) for part in recordings]
        self._spectra = [self._everett_spectrum(part) for part in self._parts]
        self._width = sum(part.fixed.shape[1] for part in self._parts)
        kept = sum(part.voltage_v.size - part.first_kept for part in self._parts)
        self._stride = -(-kept // MOST_ROWS)
        self._measured_um = np.concatenate(
            [part.displacement_um[part.first_kept :: self._stride] for part in self._parts])
        self._bending = SMOOTHING * self._measured_um.size * bending_operator(CELLS).toarray()

    def _everett_spectrum(self, part: FastLoops) -> ComplexArray:
        # Coming from the lowest voltage; of another past no more is left than an offset.
        rows = everett_regression(np.append(self._levels_v[0], part.voltage_v), self._levels_v)
        columns = rows.matrix[1:].toarray()
        # One row for each value: transforms along rows take half as long as along columns.
        return np.ascontiguousarray(rfft(closed_signal(columns), axis=0).T)

    def residual(self, dynamics: ElectricVibrationDynamics, delay_s: float) -> FloatArray:
        """Return what the best hysteresis leaves, its curvature included."""
        check_cancelled()
        columns = self._columns(dynamics, delay_s)
        quadratic, linear = columns.T @ columns, columns.T @ self._measured_um
        unknowns = self._bending.shape[0]
        quadratic[:unknowns, :unknowns] += self._bending
        scale = np.sqrt(np.maximum(np.diag(quadratic), np.finfo(float).tiny))
        solution = np.linalg.lstsq(
            quadratic / np.outer(scale, scale), linear / scale, rcond=1e-13)[0] / scale
        bent = solution[:unknowns] @ (self._bending @ solution[:unknowns])
        return np.append(self._measured_um - columns @ solution, np.sqrt(max(bent, 0.0)))

    def hysteresis(self, dynamics: ElectricVibrationDynamics, delay_s: float) -> PreisachModel:
        """Return the hysteresis of least error whose density is nowhere negative."""
        columns = self._columns(dynamics, delay_s)
        unknowns = self._bending.shape[0]
        responses, fixed = columns[:, :unknowns], columns[:, unknowns:]
        count = self._measured_um.size
        solution, *_ = nonnegative_minimum(
            csr_array((responses.T @ responses + self._bending) / count),
            responses.T @ self._measured_um / count, bounded_operator(CELLS),
            responses.T @ fixed / count, fixed.T @ fixed / count,
            fixed.T @ self._measured_um / count)
        bounded = np.maximum(bounded_operator(CELLS) @ solution, 0.0)
        density, reversible = np.split(bounded, [-CELLS])
        width_v = (self._levels_v[-1] - self._levels_v[0]) / CELLS
        return PreisachModel(
            self._levels_v[0], self._levels_v[-1], lower_triangle(density, CELLS) / width_v**2,
            0.0, reversible / width_v)

    def _columns(self, dynamics: ElectricVibrationDynamics, delay_s: float) -> FloatArray:
        """Responses to the Everett values, and the columns of each recording beside them."""
        blocks, first = [], 0
        for part, spectrum in zip(self._parts, self._spectra, strict=True):
            size = part.voltage_v.size + samples_added(part.voltage_v.size)
            frequency_hz = np.fft.rfftfreq(size, part.sample_period_s)
            forward = held_response(dynamics, frequency_hz, part.sample_period_s, delay_s)
            responses = irfft(spectrum * forward, size)
            own = np.zeros((part.voltage_v.size, self._width))
            own[:, first : first + part.fixed.shape[1]] = part.fixed
            first += part.fixed.shape[1]
            rows = slice(part.first_kept, part.voltage_v.size, self._stride)
            blocks.append(np.hstack([responses[:, rows].T, own[rows]]))
        return np.vstack(blocks)
