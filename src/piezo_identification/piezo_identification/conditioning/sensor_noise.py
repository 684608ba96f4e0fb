# SPDX-License-Identifier: BSD-3-Clause
"""Estimate the sensor's noise from repeats, from rests, or from high frequencies."""

from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import blake2b

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import correlate
from scipy.signal.windows import hann

from piezo_common.arrays import ComplexArray, FloatArray


@dataclass(frozen=True)
class NoiseSettings:
    """Settings of the noise estimates."""

    high_bands: int = 4
    """Number of bands in the upper half of the spectrum; the quietest gives the noise."""
    segment: int = 256
    """Samples of a segment for the spectrum; short segments allow a median over many."""
    rounding: float = 1e-6
    """Largest difference between repeats as a fraction of the voltage's energy, and of its span."""
    fewest_at_rest: int = 200
    """Fewest samples of a rest from which the noise is estimated."""
    drift_order: int = 2
    """Degree of the polynomial that is removed as drift or creep from repeats or from a rest."""
    over_sampled: float = 0.1
    """Noise estimate from the quietest band over the RMS displacement, below which the band shows
    the sensor's noise. A model error in proportion to the motion then adds at most a hundredth of
    its power to the band."""


SETTINGS = NoiseSettings()

AT_ONCE = 128
"""Number of segments of a signal transformed together, which is much faster than one by one."""

_PERIODS: dict[bytes, int | None] = {}
"""Periods already found, by the hash of the voltages."""


def sensor_noise_um(displacement_um: FloatArray, voltage_v: FloatArray, residual_um: FloatArray,
                    period: int | None) -> float:
    """Estimate the standard deviation of the sensor's noise in three ways, and return the least.

    Model errors can only increase the estimates. The signals are (N,), and the period of the
    voltage in samples is that of `repeated_period`.
    """
    found = noise_estimates_um(displacement_um, voltage_v, residual_um, period)
    return min(noise for noise in found if noise)


def noise_estimates_um(displacement_um: FloatArray, voltage_v: FloatArray, residual_um: FloatArray,
                       period: int | None, fewest: int = SETTINGS.fewest_at_rest) -> list[float]:
    """Return the noise of high frequencies, of rests of `fewest` samples and of repeats."""
    found = [
        noise_floor_um(residual_um),
        noise_from_rest_um(displacement_um, voltage_v, fewest),
        noise_from_repeats_um(displacement_um, period) if period else None,
    ]
    return [noise for noise in found if noise is not None]


def shows_noise(displacement_um: FloatArray, voltage_v: FloatArray) -> bool:
    """Return whether a recording determines the sensor's noise, and not only an upper bound.

    Rests, repeats, or a band with little motion determine it. If the stage moves in all bands,
    errors of the model look like noise.
    """
    if repeated_period(voltage_v) or noise_from_rest_um(displacement_um, voltage_v) is not None:
        return True
    moving_um = displacement_um - displacement_um.mean()
    return noise_floor_um(moving_um) < SETTINGS.over_sampled * float(np.std(moving_um))


def repeated_period(voltage_v: FloatArray) -> int | None:
    """Return the period in samples with which the voltage repeats; None if it is not periodic."""
    # Cached, as every compared model needs the period of the same voltages.
    digest = blake2b(np.ascontiguousarray(voltage_v, dtype=float).tobytes()).digest()
    if digest not in _PERIODS:
        _PERIODS[digest] = _found_period(voltage_v)
    return _PERIODS[digest]


def _found_period(voltage_v: FloatArray) -> int | None:
    varying_v = voltage_v - voltage_v.mean()
    if not np.any(varying_v):
        return None
    # Sums of squared differences between the voltage and its shifted copies.
    energy = np.cumsum(varying_v**2)
    lags = np.arange(1, voltage_v.size // 2 + 1)
    products = correlate(varying_v, varying_v, method="fft")[voltage_v.size :][: lags.size]
    squares = energy[-1] - energy[lags - 1] + energy[-1 - lags] - 2.0 * products
    for lag in lags[squares < SETTINGS.rounding * energy[-1]]:
        if np.allclose(voltage_v[lag:], voltage_v[:-lag], rtol=0.0,
                       atol=SETTINGS.rounding * np.ptp(voltage_v)):
            return int(lag)
    return None


def noise_floor_um(residual_um: FloatArray) -> float:
    """Estimate the standard deviation of white noise from the high frequencies of a residual.

    At the highest frequencies of a fast recording, the stage does not move, so that the signal is
    sensor noise. The median in the quietest band of the upper half is used, which ignores tones.
    """
    segment = int(min(SETTINGS.segment, residual_um.size))
    last = segment // 2
    power = np.concatenate([np.abs(spectra[:, last // 2 + 1 : last]) ** 2
                            for spectra in spectra_of_segments(residual_um, segment, 0)])
    lines = np.median(power, axis=0) / (
        np.sum(hann(segment, sym=False) ** 2) * _median_of_exponentials(len(power)))
    bands = min(SETTINGS.high_bands, max(lines.size, 1))
    return float(np.sqrt(min(np.median(part) for part in np.array_split(lines, bands))))


def spectra_of_segments(signal: FloatArray, size: int,
                        drift_order: int) -> Iterator[ComplexArray]:
    """Yield the spectra of segments of a signal, (N,), in batches of shape (segments, lines).

    Each segment has `size` samples, at most N. Its drift, a polynomial of degree `drift_order`, is
    removed, and a Hann window is applied.
    """
    window = hann(size, sym=False)
    drift = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, size), drift_order + 1))[0]
    segments = sliding_window_view(signal, size)[:: size - size // 2]
    for first in range(0, len(segments), AT_ONCE):
        part = segments[first : first + AT_ONCE]
        yield np.fft.rfft(window * (part - part @ drift @ drift.T))


def _median_of_exponentials(count: int) -> float:
    """Return the expected median of `count` exponential variables with mean 1."""
    even = 2.0 * np.arange(1, (count - 1) // 2 + 1)
    return float(1.0 + np.sum(1.0 / (even + 1.0) - 1.0 / even))


def noise_from_rest_um(displacement_um: FloatArray, voltage_v: FloatArray,
                       fewest: int = SETTINGS.fewest_at_rest) -> float | None:
    """Estimate the noise while the voltage rests; None if it never rests for `fewest` samples."""
    edges = np.flatnonzero(np.diff(voltage_v, prepend=np.nan, append=np.nan) != 0.0)
    # The stage may still settle in the first half.
    starts, ends = edges[:-1] + np.diff(edges) // 2, edges[1:]
    long = ends - starts >= fewest
    spreads = [spread_about_line(displacement_um[start:end])
               for start, end in zip(starts[long], ends[long], strict=True)]
    return float(np.median(spreads)) if spreads else None


def spread_about_line(values: FloatArray) -> float:
    """Return the standard deviation about a line; written for speed with thousands of rests."""
    at = np.arange(values.size) - 0.5 * (values.size - 1)
    about = values - values.mean()
    return float(np.std(about - at * ((at @ about) / (at @ at))))


def noise_from_repeats_um(displacement_um: FloatArray, period: int) -> float | None:
    """Estimate the standard deviation of the noise from repeats of a waveform with some period.

    It is None for fewer than two repeats.
    """
    repeats = displacement_um.size // period
    if repeats < 2:
        return None
    played = displacement_um[: repeats * period].reshape(repeats, period)
    return float(np.sqrt(np.mean(without_drift(np.diff(played, axis=0)) ** 2) / 2.0))


def without_drift(values: FloatArray) -> FloatArray:
    """Return the rows of some values, (..., N), without their polynomial drift."""
    basis = np.polynomial.legendre.legvander(
        np.linspace(-1.0, 1.0, values.shape[-1]), SETTINGS.drift_order)
    return np.asarray(values - (basis @ np.linalg.lstsq(basis, values.T, rcond=None)[0]).T)
