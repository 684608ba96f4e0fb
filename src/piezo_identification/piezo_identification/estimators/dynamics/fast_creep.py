# SPDX-License-Identifier: BSD-3-Clause
"""Slow motion in a fast record that is no vibration: fast creep, and errors of the hysteresis.

Materials creep on all time scales. Creep within the half period of a fast square wave is in no
creep recording, and a fit of lag and modes alone would be biased by it. An inexact hysteresis
leaves large slow errors, which such a fit would describe by modes that no structure has.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.row_alignment import SIGNIFICANT
from piezo_identification.conditioning.settling import RINGING, SLOWER_THAN_MODES
from piezo_identification.estimators.dynamics.fast_record import FastRecord, FreeFit, independent
from piezo_identification.estimators.dynamics.output_error import ROWS_OF_SEARCH
from piezo_identification.estimators.dynamics.pole_search import (
    MOST_MODES,
    free_fits,
    nested_fits,
)
from piezo_identification.estimators.estimate import (
    DECISIVE,
    ROWS_OF_DECAY,
    Estimate,
    creep_of_partial_fractions,
    without_span,
)
from piezo_identification.fitting.nonnegative_regression import nonnegative_least_squares
from piezo_models.linear.dynamics import CreepDynamics

RATES_PER_DECADE = 2.5
"""Number of exponentials per decade that represent any creep between them."""

FASTER_THAN_KNOWN = 3.0
"""Factor between the fastest known creep and the slowest creep that is sought."""

MOST_TURNS = 4
"""Largest number of times that creep is sought again with the dynamics corrected for creep."""


LEAST_DAMPING = 5e-4
"""Damping ratio below which no glued or screwed structure has modes."""

HEAVY_DAMPING, FAR_BELOW = 0.15, 0.05
"""Damping ratio, and frequency relative to the lowest ringing mode, of slow errors. Structures have
no such modes, but errors of the hysteresis look like them."""

MOST_WAVES = 300
"""Largest number of half periods of the fastest cosine: a longer record separates slow motion from
vibration without them."""

MOST_OF_THE_MOTION = 0.95
"""Part of the input power that defines the frequency of its loops."""


Creep = tuple[CreepDynamics, dict[str, tuple[float, ...]]]
"""Creep in addition to the known one, with standard deviations of its poles and zeros; the poles
are fixed, not fitted."""


def fit_with_fast_creep(
    record_without: Callable[[CreepDynamics], FastRecord], creep: CreepDynamics,
    fit: Callable[[FastRecord], Estimate],
) -> Estimate:
    """Fit the dynamics of a record, with fast creep if the record shows it.

    `record_without` returns the record with a given creep removed. The `creep` of the estimate is
    in addition to the known one.
    """
    made = cache(record_without)
    found = fast_creep(made, creep)
    if found is None:
        return fit(made(creep))
    further, deviations = found
    again = fit(made(joined_creep(creep, further)))
    return replace(again, creep=further, creep_deviations=deviations)


def fast_creep(
    record_without: Callable[[CreepDynamics], FastRecord], creep: CreepDynamics,
) -> Creep | None:
    """Find creep in a fast record: exponentials slower than all ringing modes.

    Free poles show whether there is any: one of them is then real and slow. It is creep if the
    record without it is explained as well by the information criterion, usually with fewer poles.
    The slow poles bias the others, and with them the creep. The creep is therefore sought again
    with the corrected dynamics as long as that explains the record better.
    """
    free = best_free_fit(record_without(creep))
    record = record_without(creep).thinned(ROWS_OF_SEARCH)
    rates = sought_rates(record, free, creep)
    if not (np.abs(free.poles) < rates.max(initial=0.0)).any():
        return None
    # Stages have creep but no overdamped modes, so that the creep which replaces them may cost
    # evidence, which is half of the criterion.
    best, most = None, record.log_evidence(free, free.numbers) - 0.5 * DECISIVE
    for _ in range(MOST_TURNS):
        is_slow = np.abs(free.poles) < rates.max()
        free = replace(free, poles=free.poles[~is_slow], residues=free.residues[~is_slow])
        found = _positive_parts(record, free, rates)
        if found is None:
            break
        without = record_without(joined_creep(creep, found[0]))
        free = best_free_fit(without, free)
        evidence = record.log_evidence(free, free.numbers)
        if evidence <= most:
            break
        best, most = found, evidence
    return best


def sought_rates(record: FastRecord, free: FreeFit, creep: CreepDynamics) -> FloatArray:
    """Return rates (rad/s), (R,), that represent any creep which a fast record could show.

    They start above the known creep, or where the record lasts for one decay. They end below all
    ringing modes, or where a decay lasts for one row. There are none if nothing rings, or if the
    known creep is as fast.
    """
    period_s = record.input.sample_period_s
    fastest = min(SLOWER_THAN_MODES * _lowest_ringing(free), 1.0 / (ROWS_OF_DECAY * period_s))
    slowest = max(FASTER_THAN_KNOWN * max(creep.poles_rad_per_s, default=0.0),
                  1.0 / (record.input.samples.size * period_s))
    if slowest >= fastest:
        return np.empty(0)
    return np.geomspace(
        slowest, fastest, 1 + int(np.ceil(RATES_PER_DECADE * np.log10(fastest / slowest))))


def best_free_fit(record: FastRecord, near: FreeFit | None = None) -> FreeFit:
    """Return the fit of free poles with the most evidence.

    The rows of the record are thinned to save time. The fit starts from the poles of the fit
    `near`; by default from those of a vector fit.
    """
    thin = record.thinned(ROWS_OF_SEARCH)
    fits = free_fits(thin, MOST_MODES) if near is None else nested_fits(
        thin, near.poles, near.delay)
    return max(fits, key=lambda fit: thin.log_evidence(fit, fit.numbers))


def joined_creep(first: CreepDynamics, second: CreepDynamics) -> CreepDynamics:
    """Return the series connection of two creeps."""
    return CreepDynamics(
        tuple(sorted((*first.poles_rad_per_s, *second.poles_rad_per_s))),
        tuple(sorted((*first.zeros_rad_per_s, *second.zeros_rad_per_s))))


def project_out_slow_error(record: FastRecord) -> FastRecord:
    """Remove slow errors from a record if it has them; otherwise return the same record.

    It has them if its loops are far slower than the ringing modes, and free poles form slow
    oscillating pairs, which neither a lag nor creep has. Slow cosines among the further signals
    then describe the errors; of a long record, slow lines are left out.
    """
    poles = best_free_fit(record).poles
    frequencies, dampings = np.abs(poles), -poles.real / np.abs(poles)
    period_s = record.input.sample_period_s
    far_above = loop_rad_per_s(record.input.samples, period_s) / FAR_BELOW
    # Superfluous poles may be faster than half the sample rate, which no row shows.
    rings = ((dampings >= LEAST_DAMPING) & (dampings < HEAVY_DAMPING)
             & (frequencies > far_above) & (frequencies < np.pi / period_s))
    if not rings.any():
        return record
    fastest = FAR_BELOW * frequencies[rings].min()
    waves = min(int(fastest * np.ptp(record.kept) * period_s / np.pi), MOST_WAVES)
    if not waves or not np.any((poles.imag != 0.0) & (frequencies < fastest)):
        return record
    if record.is_long:
        return replace(record, slowest_rad_per_s=fastest)
    return replace(record, fixed=np.column_stack([record.fixed, slow_waves(record.kept, waves)]))


def loop_rad_per_s(input_um: FloatArray, sample_period_s: float) -> float:
    """Return the frequency up to which nearly all power of an input lies, shape (N,)."""
    power = np.abs(np.fft.rfft((input_um - input_um.mean()) * np.hanning(input_um.size))) ** 2
    line = int(np.searchsorted(np.cumsum(power), MOST_OF_THE_MOTION * power.sum()))
    return 2.0 * np.pi * line / (input_um.size * sample_period_s)


def slow_waves(rows: NDArray[np.intp], count: int) -> FloatArray:
    """Return cosines of 1, 2, 3, ... half periods over rows of a record, shape (N, count)."""
    phase = np.pi * (rows - rows[0]) / np.ptp(rows)
    return np.cos(np.outer(phase, np.arange(1, count + 1)))


def _lowest_ringing(free: FreeFit) -> float:
    """Lowest frequency (rad/s) of ringing poles; 0 if there are none."""
    frequencies = np.abs(free.poles)
    rings = -free.poles.real < RINGING * frequencies
    return float(frequencies[rings].min(initial=np.inf)) if rings.any() else 0.0


def _responses(
    record: FastRecord, free: FreeFit, rates: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Response of dynamics with unit gain at rest, (N,), and of exponentials behind them, (N, R).

    The partial fractions of a product are those of its factors, weighted by the other factor.
    """
    poles, gain = free.poles, float(np.sum(-free.residues / free.poles).real)
    residues = free.residues / gain
    of_poles = record.input.responses(poles, free.delay, record.kept).value
    of_rates = record.input.responses(-rates.astype(complex), free.delay, record.kept).value
    at_rates = np.sum(residues / (-rates[:, None] - poles), axis=1)
    weighted = residues[:, None] * rates / (rates + poles[:, None])
    return (of_poles @ residues).real, (of_poles @ weighted + of_rates * (at_rates * rates)).real


def _positive_parts(record: FastRecord, free: FreeFit, rates: FloatArray) -> Creep | None:
    """Fit positive parts of exponentials, and keep those that are significant."""
    response, exponentials = _responses(record, free, rates)
    span = independent(record.fixed)
    columns = without_span(np.column_stack([response, exponentials]), span)
    target = without_span(record.measured_um, span)
    used = np.arange(rates.size)
    while used.size:
        chosen = columns[:, [0, *(1 + used)]]
        parts, norm = nonnegative_least_squares(chosen, target)
        if parts[0] == 0.0:
            return None
        if not parts.all():
            used = used[parts[1:] > 0.0]
            continue
        covariance = np.linalg.pinv(chosen.T @ chosen) * norm**2 / target.size
        over_deviation = parts[1:] / np.sqrt(np.diag(covariance)[1:])
        if over_deviation.min() > SIGNIFICANT:
            gains = parts[1:] / parts[0]
            full = np.zeros((2 * used.size, 2 * used.size))
            full[used.size :, used.size :] = covariance[1:, 1:] / parts[0] ** 2
            return creep_of_partial_fractions(rates[used], gains, full)
        # Remove one at a time: the others become significant when a neighbour is gone.
        used = np.delete(used, np.argmin(over_deviation))
    return None
