# SPDX-License-Identifier: BSD-3-Clause
"""Poles of a fast record for a growing number of modes, each number begun from the one before."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.estimators.dynamics.fast_record import FastRecord, FreeFit
from piezo_models.linear.dynamics import ElectricVibrationDynamics

SCANNED_DELAYS = (-1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
"""In sample periods, from which the best is taken to begin with."""

PEAKS = 3
"""Peaks in the spectrum of what is left, at which a further mode is tried."""

TRIED_DAMPINGS = (0.01, 0.1, 0.8)
"""Damping ratios of a further mode to begin with."""

QUICK_EVALUATIONS = 12
"""Steps that part a good start from a bad one."""

FOLLOWED = 3
"""Starts that are followed by quick fits, and the best of those to its end."""

RANDOM_STARTS = 2
"""Starts with drawn poles, beside those that are derived from the record."""


@dataclass(frozen=True)
class _Found:
    """What was found of a record, and what draws the starts of what is yet to be found."""

    fits: list[FreeFit] = field(default_factory=list)
    generator: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))


_FOUND: WeakKeyDictionary[FastRecord, _Found] = WeakKeyDictionary()


def free_fits(record: FastRecord, most_modes: int) -> Iterator[FreeFit]:
    """Yield the fit with free residues for 0, 1, 2, ... modes.

    None leaves more than the one before: it begins from it with a further mode, from the poles
    that the record suggests, and from drawn ones. A record is searched once, however often this is
    asked.
    """
    found = _FOUND.setdefault(record, _Found())
    for count in range(most_modes + 1):
        if count == len(found.fits):
            found.fits.append(_with_one_more(record, found))
        yield found.fits[count]


def _with_one_more(record: FastRecord, known: _Found) -> FreeFit:
    """Fit one mode more than those that are known; none where none is known."""
    count, best = len(known.fits), known.fits[-1] if known.fits else None
    starts = [vector_of_poles(poles, count) for poles in record.starts(count)]
    suggested = len(starts)
    if best is None:
        starts.append(np.log([10.0 * record.input.sample_period_s]))
        begun = [_best_delay(record, start) for start in starts]
    else:
        starts += [_further_mode(best.vector, frequency, damping)
                   for frequency in residual_peaks(record, best)
                   for damping in TRIED_DAMPINGS]
        starts += [_further_mode(best.vector, *_drawn(record, known.generator))
                   for _ in range(RANDOM_STARTS)]
        begun = [record.free(start, best.delay) for start in starts]
        begun += [_best_delay(record, start) for start in starts[:suggested]]
    begun.sort(key=lambda fit: fit.cost)
    quick = [record.fit_free(fit.vector, fit.delay, QUICK_EVALUATIONS)
             for fit in begun[:FOLLOWED]]
    found = min(quick, key=lambda fit: fit.cost)
    found = record.fit_free(found.vector, found.delay)
    if best is None or found.cost <= best.cost:
        return found
    # A mode that no sample shows leaves what was left.
    return record.fit_free(
        _further_mode(best.vector, 10.0 / record.input.sample_period_s, 0.8), best.delay)


def vector_of_poles(poles: ComplexArray, mode_count: int) -> FloatArray:
    """Logarithms of lag, frequencies and dampings with given poles.

    Parameters
    ----------
    poles : ndarray of complex, shape (1 + 2 modes,)
        See `dynamics_of_poles`.

    Returns
    -------
    ndarray, shape (1 + 2 modes,)
    """
    dynamics = dynamics_of_poles(poles[: 1 + 2 * mode_count])
    return np.log([dynamics.time_constant_s, *dynamics.mode_frequencies_rad_per_s,
                   *dynamics.damping_ratios])


def dynamics_of_poles(poles: ComplexArray) -> ElectricVibrationDynamics:
    """Electric lag and modes with given poles.

    Parameters
    ----------
    poles : ndarray of complex, shape (1 + 2 modes,)
        In rad/s, closed under conjugation. Unstable ones are taken for their stable mirror image;
        real ones beyond the electric lag pair up to overdamped modes.
    """
    mode_count = (poles.size - 1) // 2
    # What noise made unstable starts as its stable mirror image.
    poles = -np.maximum(np.abs(poles.real), 1e-6 * np.abs(poles)) + 1j * poles.imag
    pairs = poles[poles.imag > 0.0][:mode_count]
    real = np.sort(-poles[poles.imag == 0.0].real)
    # Where all poles oscillate, the electric lag starts from the slowest of them.
    time_constant_s = 1.0 / (real[0] if real.size else np.abs(poles).min())
    products = np.concatenate([np.abs(pairs) ** 2, real[1::2] * real[2::2]])
    sums = np.concatenate([-2.0 * pairs.real, real[1::2] + real[2::2]])
    frequencies = np.sqrt(products)
    order = np.argsort(frequencies)
    dampings = sums / (2.0 * frequencies)
    return ElectricVibrationDynamics(
        float(time_constant_s), tuple(frequencies[order]), tuple(dampings[order])
    )


def _best_delay(record: FastRecord, vector: FloatArray) -> FreeFit:
    latest = 0.25 * record.input.samples.size
    return min((record.free(vector, delay) for delay in SCANNED_DELAYS if delay < latest),
               key=lambda fit: fit.cost)


def _further_mode(vector: FloatArray, frequency: float, damping: float) -> FloatArray:
    lag, frequencies, dampings = np.split(vector, [1, 1 + vector.size // 2])
    return np.concatenate([
        lag, frequencies, [np.log(frequency)], dampings, [np.log(damping)]])


def residual_peaks(record: FastRecord, free: FreeFit) -> list[float]:
    """Return the frequencies (rad/s) at which a fit leaves most.

    Parameters
    ----------
    free : FreeFit
        Its residual is taken in every row: rows far between show a frequency as another one.
    """
    whole = record.every_row
    residual = free.residual if whole is None else whole.free(free.vector, free.delay).residual
    strength = np.abs(np.fft.rfft(residual * np.hanning(residual.size)))
    unit = 2.0 * np.pi / (residual.size * record.input.sample_period_s)
    inner = strength[1:-1]
    tops = 1 + np.flatnonzero((inner >= strength[:-2]) & (inner > strength[2:]))
    strongest = tops[np.argsort(-strength[tops])][:PEAKS]
    return (unit * strongest).tolist()


def _drawn(record: FastRecord, generator: np.random.Generator) -> tuple[float, float]:
    """Frequency and damping ratio of a mode that the samples could show."""
    nyquist = np.pi / record.input.sample_period_s
    lowest = 4.0 * np.pi / (record.input.samples.size * record.input.sample_period_s)
    frequency = np.exp(generator.uniform(np.log(lowest), np.log(nyquist)))
    return float(frequency), float(np.exp(generator.uniform(np.log(0.01), 0.0)))
