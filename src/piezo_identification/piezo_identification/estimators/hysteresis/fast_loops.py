# SPDX-License-Identifier: BSD-3-Clause
"""Regression of fast recordings on the hysteresis ahead of known dynamics.

The output of the dynamics is linear in the Everett values of the hysteresis. For any dynamics, the
hysteresis of least error therefore follows from a linear regression: variable projection (Golub and
Pereyra 1973), with the Jacobian of Kaufman (1975).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, rfft
from scipy.linalg import pinvh
from scipy.sparse import csr_array

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_identification.estimators.hysteresis.density_estimate import per_volt
from piezo_identification.estimators.hysteresis.dynamics_inverse import closed_signal, samples_added
from piezo_identification.estimators.hysteresis.equations import bending_operator
from piezo_identification.estimators.hysteresis.everett_regression import everett_regression
from piezo_identification.estimators.hysteresis.nonnegative import nonnegative_minimum
from piezo_identification.estimators.hysteresis.penalties import bounded_operator
from piezo_models.hysteresis.pasts import PASTS, past_voltages
from piezo_models.hysteresis.preisach import PreisachModel

CELLS = 12
"""Cells along a threshold: enough for the input of the dynamics, few enough to filter each."""

SMOOTHING = 1e-10
"""Weight of the density's curvature."""

MOST_SAMPLES = 40_000
"""Largest number of samples fitted; more would only cost time."""

MOST_ROWS = 6_000
"""Number of compared samples, spread over all: many times the number of unknowns."""

ROUNDING = 1e-13
"""Eigenvalue of the scaled normal equations, relative to the largest, that counts as zero."""

LINES_OF_A_PEAK = 400
"""Number of parts over which a spectrum is averaged before its peaks are sought, because noise has
peaks at every line."""

Response = Callable[[FloatArray], ComplexArray]
"""Response from held values to samples, as a function of frequency (Hz)."""


@dataclass(frozen=True, eq=False)
class FastLoops:
    """A fast recording without gaps, with further components of its displacement."""

    voltage_v: FloatArray
    displacement_um: FloatArray
    """The creep is removed from the displacement, (N,)."""
    fixed: FloatArray
    """Columns with free coefficients, such as an offset, (N, K)."""
    first_kept: int
    """First sample at which these columns describe the effect of the past."""
    sample_period_s: float

    def first(self, count: int) -> "FastLoops":
        """Return only the first samples."""
        return FastLoops(self.voltage_v[:count], self.displacement_um[:count],
                         self.fixed[:count], self.first_kept, self.sample_period_s)


@dataclass(frozen=True, eq=False)
class LoopFit:
    """The hysteresis of least error for one response."""

    columns: FloatArray
    """Responses to the Everett values, then the fixed columns of each recording, (R, U)."""
    inverse: FloatArray
    """Inverse of the normal equations, (U, U)."""
    unknowns: FloatArray
    """Shape (U,)."""
    residual: FloatArray
    """Residual, followed by the square root of the curvature penalty, (R + 1,)."""

    @property
    def cost(self) -> float:
        """Sum of the squared residual."""
        return float(self.residual @ self.residual)


class LoopRegression:
    """Regression of all recordings, of one sample period, on the responses to Everett values.

    The past, one of `PASTS`, matters for new voltages until the voltage has been at either end.
    """

    def __init__(self, recordings: Sequence[FastLoops], past: str = PASTS[0]) -> None:
        self.past = past
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
        past_v = past_voltages(self.past, part.voltage_v[0], self._levels_v[0], self._levels_v[-1])
        rows = everett_regression(np.append(past_v, part.voltage_v), self._levels_v)
        columns = rows.matrix[past_v.size :].toarray()
        # Values in rows: transforms along rows take half as long as along columns.
        return np.ascontiguousarray(rfft(closed_signal(columns), axis=0).T)

    def fit(self, response: Response) -> LoopFit:
        """Return the best hysteresis for a response; its density may be negative."""
        check_cancelled()
        columns = self._columns(response)
        quadratic, linear = columns.T @ columns, columns.T @ self._measured_um
        size = self._bending.shape[0]
        quadratic[:size, :size] += self._bending
        scale = np.sqrt(np.maximum(np.diag(quadratic), np.finfo(float).tiny))
        inverse = pinvh(quadratic / np.outer(scale, scale), rtol=ROUNDING)
        inverse /= np.outer(scale, scale)
        unknowns = inverse @ linear
        bent = unknowns[:size] @ (self._bending @ unknowns[:size])
        residual_um = self._measured_um - columns @ unknowns
        return LoopFit(columns, inverse, unknowns, np.append(residual_um, np.sqrt(max(bent, 0.0))))

    def slopes(self, fit: LoopFit, changes: Callable[[FloatArray], ComplexArray]) -> FloatArray:
        """Return the derivatives of a fit's residual by the parameters of its response, (R + 1, P).

        `changes` returns those of the response, (P, F), at frequencies in Hz.
        """
        size = self._bending.shape[0]
        driven = np.vstack([
            irfft((fit.unknowns[:size] @ spectrum) * changes(frequency_hz), count)[:, rows].T
            for _, spectrum, frequency_hz, count, rows in self._each()])
        taken = fit.inverse @ (fit.columns.T @ driven)
        bent = self._bending @ fit.unknowns[:size] / max(fit.residual[-1], np.finfo(float).tiny)
        return np.vstack([fit.columns @ taken - driven, -bent @ taken[:size]])

    def peaks(self, fit: LoopFit, response: Response, most: int) -> FloatArray:
        """Return the frequencies (rad/s) of the largest residual in the longest recording."""
        longest = int(np.argmax([part.voltage_v.size - part.first_kept for part in self._parts]))
        part, spectrum, frequency_hz, count, _ = list(self._each())[longest]
        size = self._bending.shape[0]
        residual_um = part.displacement_um - irfft(
            (fit.unknowns[:size] @ spectrum) * response(frequency_hz), count)[: part.voltage_v.size]
        residual_um = (residual_um - np.mean(residual_um))[part.first_kept :]
        strength = np.abs(np.fft.rfft(residual_um * np.hanning(residual_um.size))) ** 2
        width = max(strength.size // LINES_OF_A_PEAK, 1)
        strength = np.convolve(strength, np.full(width, 1.0 / width), "same")
        inner = strength[1:-1]
        tops = 1 + np.flatnonzero((inner >= strength[:-2]) & (inner > strength[2:]))
        strongest = tops[np.argsort(-strength[tops])][:most]
        return 2.0 * np.pi * strongest / (residual_um.size * part.sample_period_s)

    def hysteresis(self, response: Response) -> PreisachModel:
        """Return the hysteresis of least error with a non-negative density."""
        columns = self._columns(response)
        size = self._bending.shape[0]
        responses, fixed = columns[:, :size], columns[:, size:]
        count = self._measured_um.size
        solution, *_ = nonnegative_minimum(
            csr_array((responses.T @ responses + self._bending) / count),
            responses.T @ self._measured_um / count, bounded_operator(CELLS),
            responses.T @ fixed / count, fixed.T @ fixed / count,
            fixed.T @ self._measured_um / count)
        bounded = np.maximum(bounded_operator(CELLS) @ solution, 0.0)
        density, reversible = per_volt(bounded, CELLS, self._levels_v)
        return PreisachModel(self._levels_v[0], self._levels_v[-1], density, 0.0, reversible)

    def _columns(self, response: Response) -> FloatArray:
        """Responses to the Everett values, and the other columns of each recording."""
        blocks, first = [], 0
        for part, spectrum, frequency_hz, count, rows in self._each():
            responses = irfft(spectrum * response(frequency_hz), count)
            own = np.zeros((part.voltage_v.size, self._width))
            own[:, first : first + part.fixed.shape[1]] = part.fixed
            first += part.fixed.shape[1]
            blocks.append(np.hstack([responses[:, rows].T, own[rows]]))
        return np.vstack(blocks)

    def _each(self) -> Iterator[tuple[FastLoops, ComplexArray, FloatArray, int, slice]]:
        """Yield the recordings with their spectra, frequencies, lengths and compared rows."""
        for part, spectrum in zip(self._parts, self._spectra, strict=True):
            count = part.voltage_v.size + samples_added(part.voltage_v.size)
            frequency_hz: FloatArray = np.fft.rfftfreq(count, part.sample_period_s).astype(float)
            yield (part, spectrum, frequency_hz, count,
                   slice(part.first_kept, part.voltage_v.size, self._stride))
