# SPDX-License-Identifier: BSD-3-Clause
"""Linear models of several axes with more and more modes."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.budget import is_time_up
from piezo_identification.axes.coupled_fit import CoupledFit, covariances, linear_numbers, refined
from piezo_identification.axes.shared_poles import relocated
from piezo_identification.axes.spectra import Spectrum, beside_resonances, smoothed
from piezo_identification.estimators.poles.vector_fitting import FIRST_DAMPING
from piezo_identification.fitting.model_weights import occam_penalty

PAIRS_STEP = 2
"""Pairs of poles that are added at once: two close modes may need both."""

JUDGED_STEPS = 3
"""Gauss-Newton steps of a model that is compared."""

MOVES = 4
"""Relocations after poles were added: those that were there have little to go."""


def growing(spectra: Sequence[Spectrum], most: int) -> Iterator[CoupledFit]:
    """Yield fits of rising order, poles being added where the residual is largest.

    The last fit has `most` pairs of poles.
    """
    count = min(PAIRS_STEP, most)
    fit = fit_of_poles(spectra, relocated(spectra, count))
    yield fit
    while count < most:
        more = min(PAIRS_STEP, most - count)
        count += more
        grown = fit_of_poles(
            spectra, relocated(spectra, count, _with_more(fit, spectra, more), MOVES))
        if grown.misfit > fit.misfit:  # relocation is no descent: begin anew
            grown = min(grown, fit_of_poles(spectra, relocated(spectra, count)),
                        key=lambda each: each.misfit)
        fit = grown
        yield fit


def fit_of_poles(spectra: Sequence[Spectrum], steps: ComplexArray) -> CoupledFit:
    """Return the fit of the gains of modes whose poles in the z plane, (m,), are given."""
    return refined(linear_numbers(spectra, steps), spectra, 0)


def evidence_of(fit: CoupledFit) -> float:
    """Return the logarithm of the evidence of a fit, up to what is common to all of one data.

    The scale of the errors is unknown: it includes what the model does not describe.
    """
    likelihood = -0.5 * fit.rows * np.log(fit.misfit)
    return float(likelihood - _cost(fit))


def local_evidence_of(fit: CoupledFit) -> float:
    """Return the evidence of a refined fit whose deviations are its own residual.

    The deviations that were estimated beside a missing mode are too large to show it.
    """
    log_likelihood = -sum(np.sum(np.log(np.maximum(
        smoothed(np.abs(residual) ** 2), np.finfo(float).tiny))) for residual in fit.residual)
    return float(log_likelihood - _cost(fit))


def with_a_further_mode(fit: CoupledFit, spectra: Sequence[Spectrum]) -> CoupledFit:
    """Return the fit with a pair of poles more, where the residual rises most above its floor."""
    floored = [beside_resonances(*each) for each in zip(spectra, fit.residual, strict=True)]
    steps = _with_more(fit, floored, 1)
    numbers = linear_numbers(spectra, relocated(spectra, steps.size, steps, MOVES))
    return refined(replace(numbers, slowest=fit.numbers.slowest), spectra, 0)


def significances(fit: CoupledFit, spectra: Sequence[Spectrum]) -> FloatArray:
    """Return for each pole by how much the likelihood would fall without it, at least: (poles,).

    That is by the Wald statistic of its gains in every motion, all other numbers free.
    """
    numbers = fit.numbers
    pairs, n = int(np.count_nonzero(numbers.steps.imag > 0.0)), numbers.gains.shape[1]
    columns = [*(np.arange(2 * pair, 2 * pair + 2) for pair in range(pairs)),
               *(np.array([place]) for place in range(2 * pairs, len(numbers.gains)))]
    found = np.zeros(len(columns))
    for output, covariance in enumerate(covariances(fit, spectra)):
        for pole, own in enumerate(columns):
            gains = numbers.gains[own, output].ravel()
            places = (own[:, None] * n + np.arange(n)).ravel()
            found[pole] += 0.5 * gains @ np.linalg.lstsq(
                covariance[np.ix_(places, places)], gains, rcond=1e-12)[0]
    return found


def without_weak_poles(fit: CoupledFit, spectra: Sequence[Spectrum]) -> CoupledFit:
    """Return the fit from which poles were taken as long as that gains evidence.

    The order is first sought with deviations that no refined model has left yet, and poles stand in
    for what was not known. All are compared by the same deviations.
    """
    while fit.numbers.steps.size > 1 and not is_time_up():
        found = significances(fit, spectra)
        if found.min() > _cost(fit):
            break  # more than all numbers cost
        weakest = int(np.argmin(found))
        kept = np.arange(fit.numbers.steps.size) != weakest
        fewer = refined(fit.numbers.with_poles(kept), spectra, JUDGED_STEPS)
        if evidence_of(fewer) <= evidence_of(fit):
            break
        fit = fewer
    return fit


def _cost(fit: CoupledFit) -> float:
    return occam_penalty(None, np.ones(fit.count), fit.rows, fit.rows)


def _with_more(fit: CoupledFit, spectra: Sequence[Spectrum], pairs: int) -> ComplexArray:
    """Return the poles of a fit and pairs more, where the residual is largest."""
    lines = spectra[0].z.size
    density = smoothed(np.sum([np.sum(np.abs(each.weight * residual) ** 2, axis=1)
                               for each, residual in zip(spectra, fit.residual, strict=True)
                               if each.z.size == lines], axis=0))
    angles, new = np.angle(spectra[0].z), []
    for _ in range(pairs):
        angle = angles[np.argmax(density)]
        new.append(np.exp((1j - FIRST_DAMPING) * angle))
        density[np.abs(angles - angle) < 2.0 * FIRST_DAMPING * angle] = 0.0
    return np.concatenate([new, fit.numbers.steps])
