# SPDX-License-Identifier: BSD-3-Clause
"""Inverses of the electric and vibration dynamics with a short preview.

The sampled dynamics have zeros outside the unit circle, so no causal inverse is stable (thesis
6.2 suggests an online inverse). Each inverse here uses the next samples of the reference, and is a
filter ``sum_k a[k] v[n - k] = sum_k b[k] r[n + preview - k]`` with a stable denominator.
"""

from dataclasses import dataclass

import control
import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray
from scipy.signal import lfilter, lfilter_zi

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_models.linear.dynamics import zoh, zoh_response

METHODS = ("least_squares", "zero_phase", "derivatives")

PREVIEW_SAMPLES = 20
BANDWIDTH_HZ = 2500.0
# Weight of the taps in the least squares; it limits the amplification of noise.
TAP_WEIGHT = 1e-6
GRID = 400
# Degree of the polynomial through nearby samples, from which the derivatives are computed.
POLYNOMIAL_DEGREE = 9
# For an inverse that predicts: length of its past, and weight of its taps, which limits the
# amplification beyond the band.
MEMORY_S = 4e-3
PREDICTION_WEIGHT = 1e-3
LARGEST_RESIDUAL = 0.3
# Zeros closer to the unit circle than this would ring for long if they were cancelled.
LARGEST_CANCELLED_ZERO = 0.8
# Newton's method doubles the digits: one step reaches all of them, the second confirms it.
ZERO_REFINEMENTS = 2


@dataclass(frozen=True, eq=False)
class PreviewInverse:
    """A filter from the reference to the input of the dynamics."""

    numerator: FloatArray
    denominator: FloatArray

    preview_samples: int
    """Samples of the reference that it needs beyond the sample of its output."""

    def response(self, frequency_hz: ArrayLike, sample_period_s: float) -> ComplexArray:
        """Return the complex response, with the preview counted as an advance."""
        z: ComplexArray = np.exp(2j * np.pi * np.asarray(frequency_hz) * sample_period_s)
        return (z**self.preview_samples * np.polyval(self.numerator[::-1], 1 / z)
                / np.polyval(self.denominator[::-1], 1 / z))

    def state(self, rest: float) -> FloatArray:
        """Return the state of the filter after a long rest at a level of the reference."""
        return rest * lfilter_zi(self.numerator, self.denominator)

    def apply(self, reference: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Filter the next samples, shape (N,); return the result and the filter's state after it.

        The first sample lies `preview_samples` after that of the result.
        """
        return lfilter(self.numerator, self.denominator, reference, zi=state)


def preview_inverse(system: control.StateSpace, sample_period_s: float,
                    method: str = "least_squares",
                    preview_samples: int = PREVIEW_SAMPLES) -> PreviewInverse:
    """Design an inverse of continuous dynamics with a hold at the input.

    Parameters
    ----------
    system : control.StateSpace
        Continuous, strictly proper, without creep.
    method : str
        ``least_squares``: a finite filter that fits the inverse up to `BANDWIDTH_HZ`.
        ``zero_phase``: zero phase error tracking (Tomizuka), whose gain error is reduced by as many
        terms of its series as the preview allows (extended bandwidth).
        ``derivatives``: the polynomial in s of the inverse, applied to the derivatives of a
        polynomial that is fitted to nearby samples (Savitzky and Golay). It averages the noise of
        measured or manually given references. Half a sample of advance compensates the hold.

    Raises
    ------
    ValueError
        If the method is unknown, or does not suit these dynamics or this preview.
    """
    if method not in METHODS:
        raise ValueError(f'unknown inversion {method!r}: use one of {", ".join(METHODS)}')
    design = {"least_squares": _least_squares, "zero_phase": _zero_phase,
              "derivatives": _derivatives}[method]
    return design(system, sample_period_s, preview_samples)


def _least_squares(system: control.StateSpace, sample_period_s: float,
                   preview_samples: int) -> PreviewInverse:
    lag = np.arange(-preview_samples, preview_samples + 1)
    taps = _fitted_taps(system, sample_period_s, lag, BANDWIDTH_HZ, TAP_WEIGHT)
    return PreviewInverse(taps, np.ones(1), preview_samples)


def _fitted_taps(system: control.StateSpace, sample_period_s: float, lag: NDArray[np.int64],
                 band_hz: float, tap_weight: float) -> FloatArray:
    """Return the taps at given lags with the best fit of the inverse up to a frequency."""
    frequency_hz = np.linspace(0.0, band_hz, GRID)
    response = zoh_response(system, frequency_hz, sample_period_s)
    turns = np.exp(-2j * np.pi * sample_period_s * np.outer(frequency_hz, lag))
    rows = response[:, None] * turns
    dc = np.sqrt(GRID) * rows[:1].real
    matrix = np.vstack([rows.real, rows.imag, dc, tap_weight * np.eye(lag.size)])
    wanted = np.concatenate([np.ones(GRID), np.zeros(GRID), [np.sqrt(GRID)], np.zeros(lag.size)])
    taps = np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    return taps / (taps.sum() * response[0].real)  # exact at rest


def short_preview_inverse(system: control.StateSpace, sample_period_s: float,
                          preview_samples: int, band_hz: float) -> PreviewInverse:
    """Design an inverse for a reference that is known for less than `PREVIEW_SAMPLES`.

    It is a finite filter that also uses past samples, from which a signal without frequencies above
    the band is predicted. With a longer preview the result is that of `preview_inverse`, whose
    system it takes, for any band. Raises ValueError if the error at the end of the band exceeds
    `LARGEST_RESIDUAL`.
    """
    if preview_samples >= PREVIEW_SAMPLES:
        return preview_inverse(system, sample_period_s)
    lag = np.arange(-preview_samples, round(MEMORY_S / sample_period_s) + 1)
    taps = _fitted_taps(system, sample_period_s, lag, band_hz, PREDICTION_WEIGHT * np.sqrt(GRID))
    inverse = PreviewInverse(taps, np.ones(1), preview_samples)
    residual = np.abs(1.0 - inverse.response(band_hz, sample_period_s)
                      * zoh_response(system, [band_hz], sample_period_s))[0]
    if residual > LARGEST_RESIDUAL:
        raise ValueError(
            f"with {preview_samples} samples of preview {100 * residual:.0f} % of a reference at "
            f"{band_hz:g} Hz would remain: declare a lower frequency, or publish "
            f"{PREVIEW_SAMPLES} samples ahead")
    return inverse


def _zero_phase(system: control.StateSpace, sample_period_s: float,
                preview_samples: int) -> PreviewInverse:
    sampled = zoh(system, sample_period_s)
    poles, zeros = control.poles(sampled), _exact_zeros(sampled)
    kept = zeros[np.abs(zeros) > LARGEST_CANCELLED_ZERO]
    cancelled = zeros[np.abs(zeros) <= LARGEST_CANCELLED_ZERO]
    uncancelled = np.real(np.poly(kept)) / np.real(np.prod(1 - kept))  # in falling powers of z
    # B(z) B(1/z) is symmetric, with gain 1 at rest.
    zero_phase = np.convolve(uncancelled, uncancelled[::-1])
    # 1 / x is expanded in powers of 1 - x.
    rest = -zero_phase
    rest[len(kept)] += 1.0
    relative_degree = poles.size - zeros.size
    advance = relative_degree + len(kept)
    terms = (preview_samples - advance) // len(kept) if len(kept) else 0
    if advance > preview_samples:
        raise ValueError(f"zero phase tracking needs {advance} samples of preview, not "
                         f"{preview_samples}: take more, or use least_squares")
    series = np.ones(1)
    for _ in range(terms):
        series = np.convolve(series, rest)
        series[len(series) // 2] += 1.0
    numerator = np.convolve(np.convolve(np.real(np.poly(poles)), uncancelled[::-1]), series)
    denominator = np.real(np.poly(cancelled))
    numerator = numerator * denominator.sum() / numerator.sum() / _rest_gain(sampled)
    return PreviewInverse(numerator, denominator, advance + len(series) // 2)


def _exact_zeros(system: control.StateSpace) -> ComplexArray:
    """Refine the zeros to full accuracy, because the series amplifies their errors."""
    zeros = control.zeros(system).astype(complex)
    identity = np.eye(system.nstates)
    for _ in range(ZERO_REFINEMENTS):
        for n, zero in enumerate(zeros):
            once = np.linalg.solve(zero * identity - system.A, system.B)
            twice = np.linalg.solve(zero * identity - system.A, once)
            value, slope = (system.C @ once)[0, 0] + system.D[0, 0], -(system.C @ twice)[0, 0]
            zeros[n] -= value / slope
    return zeros


def _rest_gain(sampled: control.StateSpace) -> float:
    return float(np.real(sampled(1.0)))


def _derivatives(system: control.StateSpace, sample_period_s: float,
                 preview_samples: int) -> PreviewInverse:
    if control.zeros(system).size:
        raise ValueError("the inverse of dynamics with antiresonances is no polynomial of "
                         "derivatives: use least_squares or zero_phase")
    window = 2 * preview_samples + 1
    degree = min(POLYNOMIAL_DEGREE, window - 1)
    poles = control.poles(system)
    if poles.size > degree:
        raise ValueError(f"a preview of {preview_samples} samples gives no derivative of order "
                         f"{poles.size}: take more")
    # With time in half windows, the inverse's polynomial and the fit have coefficients of order
    # one.
    half_window_s = preview_samples * sample_period_s
    inverse = np.real(np.poly(poles * half_window_s))[::-1]
    at_half_sample = 0.5 / preview_samples
    wanted = [sum(gain * legendre.legval(at_half_sample, legendre.legder(basis, order))
                  for order, gain in enumerate(inverse / inverse[0]))
              for basis in np.eye(degree + 1)]
    taps = _projection_taps(preview_samples, degree, np.array(wanted))
    taps /= taps.sum() * np.real(system(0.0))  # exact at rest
    return PreviewInverse(taps[::-1], np.ones(1), preview_samples)


def _projection_taps(half_window: int, degree: int, functional: FloatArray) -> FloatArray:
    """Return the taps of a linear functional of the best polynomial fit to a window.

    The functional is given by its value for each Legendre polynomial on the window: with powers of
    time the condition of the least squares is 1e12, and the taps depend on the processor.
    """
    grid = np.arange(-half_window, half_window + 1) / half_window
    orthogonal, triangle = np.linalg.qr(legendre.legvander(grid, degree))
    return orthogonal @ np.linalg.solve(triangle.T, functional)
