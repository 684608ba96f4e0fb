# SPDX-License-Identifier: BSD-3-Clause
"""Tests of a residual: whether it is noise, and on which quantities it depends."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.analysis.gain_over_frequency import band_of_most, spectrum
from piezo_identification.conditioning.waveforms import SETTINGS as WAVEFORMS
from piezo_identification.conditioning.waveforms import turning_points
from piezo_identification.fitting.evidence import correlated_scale
from piezo_identification.fitting.noise_estimate import residual_um
from piezo_identification.fitting.regression import Fit, Regression

WORTH_REPORTING = 0.05
"""Smallest share of the residual power related to a quantity for which the quantity is named."""

BAND_99 = 2.576
"""Standard deviations within which 99 % of a normal distribution lie."""

MOST_LAGS = 100
"""Largest shift of a residual in samples; slower errors show in the dependences."""

BINS = 24
"""Number of bins, with equally many samples, for the mean of a residual."""

WHITENING_ORDER = 6
"""Number of earlier samples used to predict an input to make it white."""


@dataclass(frozen=True)
class CorrelationTest:
    """Correlation over lags, and the band that contains 99 % of it if there is none."""

    lags: np.ndarray
    """Shape (n,)."""
    correlation: np.ndarray
    """Shape (n,)."""
    band: float

    @property
    def share_outside(self) -> float:
        """Share of the lags outside the band; about 0.01 if there is no correlation."""
        return float(np.mean(np.abs(self.correlation) > self.band))

    @property
    def passed(self) -> bool:
        """Return whether the number of lags outside is due to chance, and none is far outside."""
        lags = self.lags.size
        if np.abs(self.correlation).max() > 2.0 * self.band:
            return False
        by_chance = 0.01 * lags + BAND_99 * np.sqrt(0.01 * lags) + 0.5
        return bool(self.share_outside * lags <= by_chance)


def whiteness(residual_um: FloatArray) -> CorrelationTest:
    """Return the autocorrelation of a residual, (N,)."""
    residual = residual_um - residual_um.mean()
    lags = np.arange(1, min(MOST_LAGS, residual.size // 4) + 1)
    return CorrelationTest(lags, _correlation(residual, residual, lags),
                           BAND_99 / np.sqrt(residual.size))


def input_correlation(residual_um: FloatArray, input: FloatArray) -> CorrelationTest:
    """Correlate a residual with earlier values of an input, both (N,).

    Both are filtered first so that the input becomes white, because a smooth input correlates with
    everything.
    """
    white_input, coefficients = _whitened(input - input.mean())
    residual = np.convolve(residual_um - residual_um.mean(), coefficients, mode="valid")
    lags = np.arange(0, min(MOST_LAGS, residual.size // 4) + 1)
    return CorrelationTest(lags, _correlation(residual, white_input, lags),
                           BAND_99 / np.sqrt(residual.size))


def _whitened(signal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Make a signal white by an autoregressive filter; return it, and the filter."""
    order = WHITENING_ORDER
    lagged = np.lib.stride_tricks.sliding_window_view(signal, order + 1)[:, -2::-1]
    weights = np.linalg.lstsq(lagged, signal[order:], rcond=1e-10)[0]
    coefficients = np.concatenate([[1.0], -weights])
    return np.convolve(signal, coefficients, mode="valid"), coefficients


def _correlation(later: FloatArray, earlier: FloatArray, lags: NDArray[np.intp]) -> FloatArray:
    scale = np.linalg.norm(later) * np.linalg.norm(earlier)
    if scale == 0.0:
        return np.zeros(lags.size)
    return np.array([later[lag:] @ earlier[: earlier.size - lag] for lag in lags]) / scale


@dataclass(frozen=True)
class Dependence:
    """Mean of the residual in bins of a quantity."""

    quantity: str
    """Name of the quantity with its unit."""
    centre: np.ndarray
    mean_um: np.ndarray
    band_um: np.ndarray
    """Centre, mean and band of each bin, (n,); 99 % of the means lie within the band if the
    residual does not depend on the quantity."""
    share: float
    """Share of the residual's variance that the means explain, beyond chance."""


def dependence(residual_um: FloatArray, values: FloatArray, quantity: str) -> Dependence:
    """Estimate how a residual depends on the values of a quantity, both (N,)."""
    # Bins of equally many samples each.
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)))
    index = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(0, edges.size - 2))
    count = np.bincount(index)
    used = count > 0
    means = np.bincount(index, residual_um) / np.maximum(count, 1)
    mean, rest = means[used], residual_um - means[index]
    centre = np.bincount(index, values)[used] / count[used]
    count = count[used]
    # Neighbouring samples are correlated: a bin has fewer independent ones than samples.
    variance, chance = float(np.var(residual_um)), float(np.var(rest))
    correlated = correlated_scale(rest) ** 2 / chance if chance > 0.0 else 1.0
    band = BAND_99 * np.sqrt(chance * np.minimum(1.0, correlated / count))
    between = float(np.sum(count * (mean - residual_um.mean()) ** 2) / residual_um.size)
    by_chance = chance * min(1.0, (count.size - 1) * correlated / residual_um.size)
    share = max(0.0, between - by_chance) / variance if variance > 0.0 else 0.0
    return Dependence(quantity, centre, mean, band, share)


def dependences(residual_um: FloatArray, displacement_um: FloatArray, voltage_v: FloatArray,
                time_s: FloatArray) -> list[Dependence]:
    """Estimate how a residual depends on quantities that may be related to effects, all (N,)."""
    speed = np.gradient(displacement_um, time_s)
    amplitude, history = _branches(voltage_v)
    direction = np.sign(np.gradient(voltage_v))
    return [
        dependence(residual_um, values, quantity)
        for quantity, values in (
            ("displacement (um)", displacement_um),
            ("speed (um/s)", speed),
            ("voltage span of the branch (V)", amplitude),
            ("direction", direction),
            ("voltage of the last reversal (V)", history),
            ("time (s)", time_s),
        )
    ]


def _branches(voltage_v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the span of the branch of each sample, and its initial voltage."""
    points = turning_points(voltage_v, WAVEFORMS.smallest_reversal * np.ptp(voltage_v))
    span, start_v = np.zeros(voltage_v.size), np.full(voltage_v.size, voltage_v[0])
    for start, end in zip(points[:-1], points[1:], strict=True):
        span[start : end + 1] = abs(voltage_v[end] - voltage_v[start])
        start_v[start : end + 1] = voltage_v[start]
    return span, start_v


def describe_residual(regression: Regression, fit: Fit) -> str:
    """Describe the residual of a fit, in one sentence for each recording."""
    return " ".join(_sentence(regression, fit, index)
                    for index in range(len(regression.dataset.simulated)))


def _sentence(regression: Regression, fit: Fit, index: int) -> str:
    part, noise = regression.dataset.simulated[index], regression.noise
    residual = residual_um(regression.dataset, index, fit.effects, noise)
    residual = np.where(noise.outliers[index], 0.0, residual)[part.begin :]
    frequency_hz, density = spectrum(residual, part.sample_period_s)
    low, high = band_of_most(frequency_hz[1:], density[1:])
    peak_hz = frequency_hz[1:][np.argmax(density[1:])]
    found = dependences(residual, part.simulate(fit.effects)[part.begin :],
                        part.voltage_v[part.begin :], part.time_s[part.begin :])
    strongest = max(found, key=lambda dependence: dependence.share)
    worst = part.begin + int(np.argmax(np.abs(residual)))
    text = (
        f"{part.path}: {1e3 * np.sqrt(np.mean(residual**2)):.3g} nm RMS, against "
        f"{1e3 * noise.noise_um[index]:.3g} nm of noise; largest at "
        f"{part.time_s[worst]:.4g} s, {part.voltage_v[worst]:.4g} V; most of it from "
        f"{low:.3g} to {high:.3g} Hz, strongest at {peak_hz:.4g} Hz"
    )
    if strongest.share > WORTH_REPORTING:
        text += (f"; {100 * strongest.share:.0f} % of its power goes with "
                 f"{strongest.quantity.split(' / ')[0]}")
    if whiteness(residual).passed:
        text += "; neighbouring samples are not alike"
    return f"{text}."
