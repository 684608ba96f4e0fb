# SPDX-License-Identifier: BSD-3-Clause
"""Poles of a fast record: a vector fit with too many poles, then one pair less each time."""

from collections.abc import Iterator
from itertools import combinations
from weakref import WeakKeyDictionary

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_identification.estimators.dynamics.fast_record import FastRecord, FreeFit
from piezo_identification.estimators.poles.spectral_input import SpectralInput
from piezo_identification.estimators.poles.vector_fitting import (
    LINES,
    Lines,
    residual_of_poles,
    vector_fit,
)
from piezo_models.linear.dynamics import ElectricVibrationDynamics

MOST_MODES = 8
"""Number of modes of the first fit: more than any record of one axis has shown."""

SCANNED_DELAYS = (-1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
"""Delays in sample periods, the best of which is the first start."""

NEAR_DELAYS = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)
"""Changes of the delay, in sample periods, that are tried when poles are removed."""

FOLLOWED = 3
"""Number of pole pairs, those that matter least, whose removal is tried with other delays."""

LAST_EVALUATIONS = 4
"""Number of steps in the rows of the record for poles that were found at those lines."""

LINES_A_POLE = 2
"""Smallest number of lines per pole in the first fit."""

AT_ONCE = 10.0
"""Rate of a pole, relative to the sample rate, that settles within a sample."""

HIGHEST = 0.95
"""Highest frequency of the lines, relative to half the sample rate: above it, the bilinear rate and
the weight of a few lines become arbitrarily large."""

_FOUND: WeakKeyDictionary[FastRecord, list[FreeFit]] = WeakKeyDictionary()


def free_fits(record: FastRecord, most_modes: int) -> Iterator[FreeFit]:
    """Yield the fits with free residues for 0, 1, 2, ... modes, as far as the record shows them.

    The error never increases from one to the next. The fits of a record are cached.
    """
    if record not in _FOUND:
        _FOUND[record] = nested_fits(record, *generous_poles(record))
    yield from _FOUND[record][: most_modes + 1]


def nested_fits(record: FastRecord, poles: ComplexArray, delay: float) -> list[FreeFit]:
    """Fit poles with free residues, then remove one pair at a time and refit.

    The pair whose removal increases the error least is removed. The poles (rad/s), (n,), are closed
    under conjugation; a fast one is added to an even number. The delay is in sample periods. The
    fits have 0, 1, 2, ... modes, up to the number of the given poles.
    """
    # A spectrum cannot represent edges between the samples.
    seen = record.at_lines(LINES) if record.is_on_the_clock else record
    fits = [_begun_from(seen, poles, delay)]
    while fits[-1].modes:
        check_cancelled()
        fits.append(_with_a_pair_less(seen, fits[-1]))
    fits = [record.fit_free(fit.vector, fit.delay, LAST_EVALUATIONS) for fit in reversed(fits)]
    for count in range(1, len(fits)):
        if fits[count].cost > fits[count - 1].cost:
            # A mode too fast for the samples leaves the residual as it was.
            fewer, fast_per_s = fits[count - 1], -AT_ONCE / record.input.sample_period_s
            fits[count] = _begun_from(
                record, np.append(fewer.poles, [fast_per_s, 2.0 * fast_per_s]), fewer.delay)
    return fits


def _begun_from(record: FastRecord, poles: ComplexArray, delay: float) -> FreeFit:
    if poles.size % 2 == 0:
        # A pole too fast for the samples represents the immediate response.
        poles = np.append(poles, -AT_ONCE / record.input.sample_period_s)
    return record.fit_free(vector_of_poles(poles), delay)


def _with_a_pair_less(record: FastRecord, fit: FreeFit) -> FreeFit:
    """Fit the poles without one conjugate pair, or without two of the real ones."""
    pairs = [(place, place + 1) for place in np.flatnonzero(fit.poles.imag > 0.0)]
    pairs += combinations(np.flatnonzero(fit.poles.imag == 0.0), 2)
    rated = sorted((record.free(vector_of_poles(np.delete(fit.poles, pair)), fit.delay)
                    for pair in pairs), key=lambda each: each.cost)
    # Superfluous poles can represent any delay; the remaining ones cannot.
    rated += [record.free(start.vector, start.delay + by)
              for start in rated[:FOLLOWED] for by in NEAR_DELAYS]
    start = min(rated, key=lambda each: each.cost)
    return record.fit_free(start.vector, start.delay)


def generous_poles(record: FastRecord) -> tuple[ComplexArray, float]:
    """Return poles of as many modes as a record may have, and a delay, by vector fits."""
    seen = record.at_lines(LINES)
    assert isinstance(seen.input, SpectralInput)
    held, rows = seen.input, (seen.measured_um, seen.fixed)
    shown = held.phases < HIGHEST * np.pi
    output, further = (_complex(each)[shown] for each in rows)
    stretch = np.repeat(np.arange(len(held.counts)), held.counts)[shown]
    # Transients at the ends of a stretch have the same poles.
    begun = stretch[:, None] == np.arange(0 if held.is_periodic else len(held.counts))
    # Rational in z is rational in the bilinear rate, and stable poles remain stable ones.
    rate = np.tan(0.5 * held.phases[shown])
    modes = int(np.clip(rate.size // (2 * LINES_A_POLE), 1, MOST_MODES))
    rated = []
    for delay in SCANNED_DELAYS:
        check_cancelled()
        late = held.lines[shown] * np.exp(-1j * delay * held.phases[shown])
        lines = Lines(rate, output, np.column_stack([late, begun]), further)
        poles = vector_fit(lines, 2 * modes)
        rated.append((float(np.linalg.norm(residual_of_poles(lines, poles))), delay, poles))
    _, delay, poles = min(rated, key=lambda each: each[0])
    discrete: ComplexArray = (1.0 + poles) / (1.0 - poles)
    # A negative pole has no continuous equivalent; a fast pole is the closest.
    discrete[poles.imag == 0.0] = np.abs(discrete[poles.imag == 0.0])
    return np.asarray(np.log(discrete) / held.sample_period_s, dtype=complex), delay


def _complex(rows: FloatArray) -> ComplexArray:
    real, imaginary = np.split(rows, 2)
    return real + 1j * imaginary


def vector_of_poles(poles: ComplexArray) -> FloatArray:
    """Logarithms of lag, frequencies and damping ratios of `dynamics_of_poles`, (1 + 2 modes,)."""
    dynamics = dynamics_of_poles(poles)
    return np.log([dynamics.time_constant_s, *dynamics.mode_frequencies_rad_per_s,
                   *dynamics.damping_ratios])


def dynamics_of_poles(poles: ComplexArray) -> ElectricVibrationDynamics:
    """Return electric lag and modes with given poles (rad/s), (1 + 2 modes,).

    The poles are closed under conjugation. Unstable ones are replaced by their stable mirror
    images. Real poles form overdamped modes, except the fastest, which is the electric lag.
    """
    mode_count = (poles.size - 1) // 2
    # Noise may make poles unstable.
    poles = -np.maximum(np.abs(poles.real), 1e-6 * np.abs(poles)) + 1j * poles.imag
    pairs = poles[poles.imag > 0.0][:mode_count]
    real = np.sort(-poles[poles.imag == 0.0].real)
    # If all poles oscillate, the electric lag starts from the slowest of them.
    time_constant_s = 1.0 / (real[-1] if real.size else np.abs(poles).min())
    one, other = real[:-1:2], real[1::2]
    products = np.concatenate([np.abs(pairs) ** 2, one * other])
    sums = np.concatenate([-2.0 * pairs.real, one + other])
    frequencies = np.sqrt(products)
    order = np.argsort(frequencies)
    dampings = sums / (2.0 * frequencies)
    return ElectricVibrationDynamics(
        float(time_constant_s), tuple(frequencies[order]), tuple(dampings[order])
    )
