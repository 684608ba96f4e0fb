# SPDX-License-Identifier: BSD-3-Clause
"""How large the sensor's noise is: between repeats, at rest, or in its own band."""

from dataclasses import dataclass
from hashlib import blake2b

import numpy as np
from scipy.signal import correlate
from scipy.signal.windows import hann

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.segment_spectra import spectra_of_segments


@dataclass(frozen=True)
class NoiseSettings:
    """Where the noise of the sensor is looked for.

    Attributes
    ----------
    high_bands : int
        Parts of the upper half of the spectrum; the quietest tells the noise.
    segment : int
        Samples of which a spectrum is estimated: short, so that the median is over many.
    energy_tolerance, span_tolerance : float
        Parts of the voltage's energy and span by which repeats may differ: rounding.
    fewest_at_rest : int
        Samples of a rest that counts.
    drift_order : int
        Degree of the polynomial that repeats may drift by, one from the other, as creep does.
    over_sampled : float
        White noise as strong as the quietest band of a displacement, over its RMS, below which the
        band shows the sensor's noise. A misfit in proportion to the motion then adds at most a
        hundredth of its power to it, and stands out.
    """

    high_bands: int = 4
    segment: int = 256
    energy_tolerance: float = 1e-6
    span_tolerance: float = 1e-6
    fewest_at_rest: int = 200
    drift_order: int = 2
    over_sampled: float = 0.1


SETTINGS = NoiseSettings()

_PERIODS: dict[bytes, int | None] = {}
"""What was found, by the hash of the voltages."""


def sensor_noise_um(displacement_um: FloatArray, voltage_v: FloatArray, residual_um: FloatArray,
                    period: int | None) -> float:
    """Estimate the standard deviation of the sensor's noise in three ways, and return the least.

    What a model lacks can only add to it.

    Parameters
    ----------
    displacement_um, voltage_v, residual_um : (N,) array
    period : int or None
        Samples after which the voltage repeats, as `repeated_period` finds it.
    """
    found = [
        noise_floor_um(residual_um),
        noise_from_rest_um(displacement_um, voltage_v),
        noise_from_repeats_um(displacement_um, period) if period else None,
    ]
    return min(noise for noise in found if noise)


def shows_noise(displacement_um: FloatArray, voltage_v: FloatArray) -> bool:
    """Tell whether a recording shows the sensor's noise, and does not only bound it from above.

    A rest and repeats show it, and a band in which the stage moves little. Where it moves as much
    in all bands, what a model lacks there looks like noise.

    Parameters
    ----------
    displacement_um, voltage_v : (N,) array
    """
    if repeated_period(voltage_v) or noise_from_rest_um(displacement_um, voltage_v) is not None:
        return True
    moving_um = displacement_um - displacement_um.mean()
    return noise_floor_um(moving_um) < SETTINGS.over_sampled * float(np.std(moving_um))


def repeated_period(voltage_v: FloatArray) -> int | None:
    """Find the samples after which the voltage repeats itself to the end; None if it does not.

    Parameters
    ----------
    voltage_v : (N,) array
    """
    # Each model that is compared asks again for the same voltages.
    digest = blake2b(np.ascontiguousarray(voltage_v, dtype=float).tobytes()).digest()
    if digest not in _PERIODS:
        _PERIODS[digest] = _found_period(voltage_v)
    return _PERIODS[digest]


def _found_period(voltage_v: FloatArray) -> int | None:
    varying_v = voltage_v - voltage_v.mean()
    if not np.any(varying_v):
        return None
    # Sum of the squares of the differences between the voltage and itself, some samples later.
    energy = np.cumsum(varying_v**2)
    lags = np.arange(1, voltage_v.size // 2 + 1)
    products = correlate(varying_v, varying_v, method="fft")[voltage_v.size :][: lags.size]
    squares = energy[-1] - energy[lags - 1] + energy[-1 - lags] - 2.0 * products
    for lag in lags[squares < SETTINGS.energy_tolerance * energy[-1]]:
        if np.allclose(voltage_v[lag:], voltage_v[:-lag], rtol=0.0,
                       atol=SETTINGS.span_tolerance * np.ptp(voltage_v)):
            return int(lag)
    return None


def noise_floor_um(residual_um: FloatArray) -> float:
    """Estimate the standard deviation of white noise as large as the residual's high frequencies.

    The stage follows nothing at the highest frequencies of a fast recording; what is there is the
    sensor's. The quietest part of the upper half is taken, and the median in it, so that a tone
    does not count.

    Parameters
    ----------
    residual_um : (N,) array
    """
    segment = int(min(SETTINGS.segment, residual_um.size))
    last = segment // 2
    power = np.concatenate([np.abs(spectra[:, last // 2 + 1 : last]) ** 2
                            for spectra in spectra_of_segments(residual_um, segment, 0)])
    lines = np.median(power, axis=0) / (
        np.sum(hann(segment, sym=False) ** 2) * _median_of_exponentials(len(power)))
    bands = min(SETTINGS.high_bands, max(lines.size, 1))
    return float(np.sqrt(min(np.median(part) for part in np.array_split(lines, bands))))


def _median_of_exponentials(count: int) -> float:
    """Return the expected median of so many exponential variables of mean one."""
    even = 2.0 * np.arange(1, (count - 1) // 2 + 1)
    return float(1.0 + np.sum(1.0 / (even + 1.0) - 1.0 / even))


def noise_from_rest_um(displacement_um: FloatArray, voltage_v: FloatArray,
                       fewest: int = SETTINGS.fewest_at_rest) -> float | None:
    """Estimate the noise where the voltage rests; None if it never does for long.

    Parameters
    ----------
    displacement_um, voltage_v : (N,) array
    fewest : int
        Samples of a rest that counts.
    """
    edges = np.flatnonzero(np.diff(voltage_v, prepend=np.nan, append=np.nan) != 0.0)
    # The first half may still move.
    starts, ends = edges[:-1] + np.diff(edges) // 2, edges[1:]
    long = ends - starts >= fewest
    spreads = [_spread_about_line(displacement_um[start:end])
               for start, end in zip(starts[long], ends[long], strict=True)]
    return float(np.median(spreads)) if spreads else None


def _spread_about_line(values: FloatArray) -> float:
    """Return the standard deviation about a straight line; there may be thousands of rests."""
    at = np.arange(values.size) - 0.5 * (values.size - 1)
    about = values - values.mean()
    return float(np.std(about - at * ((at @ about) / (at @ at))))


def noise_from_repeats_um(displacement_um: FloatArray, period: int) -> float | None:
    """Estimate the standard deviation of the noise from repeats of one waveform.

    Parameters
    ----------
    displacement_um : (N,) array
    period : int
        Samples of the waveform; `repeated_period` finds it.

    Returns
    -------
    float or None
        None with fewer than two repeats.
    """
    repeats = displacement_um.size // period
    if repeats < 2:
        return None
    played = displacement_um[: repeats * period].reshape(repeats, period)
    difference = np.diff(played, axis=0)
    x = np.linspace(-1.0, 1.0, period)
    basis = np.polynomial.legendre.legvander(x, SETTINGS.drift_order)
    left = difference.T - basis @ np.linalg.lstsq(basis, difference.T, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2) / 2.0))
