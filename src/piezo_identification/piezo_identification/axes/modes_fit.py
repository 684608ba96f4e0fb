# SPDX-License-Identifier: BSD-3-Clause
"""Modes and softening of several axes from fast recordings."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from piezo_common.budget import has_time_for, while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_identification.axes.coupled_fit import CoupledFit, refined, softened_numbers
from piezo_identification.axes.coupled_numbers import CoupledNumbers
from piezo_identification.axes.modal_model import residues_of
from piezo_identification.axes.mode_search import FEWEST_PERIODS
from piezo_identification.axes.order_search import (
    JUDGED_STEPS,
    evidence_of,
    growing,
    local_evidence_of,
    with_a_further_mode,
    without_weak_poles,
)
from piezo_identification.axes.sensor_delays import further_latencies, latencies
from piezo_identification.axes.spectra import Spectrum, reweighted
from piezo_models.axes.identified_axes import LIGHT

MOST_PAIRS = 40
"""Pairs of poles at which the search for the order ends in any case."""

WORSE_IN_A_ROW = 2
"""Orders without more evidence after which the search for the order ends."""

MOST_POWERS = 2
"""Powers of the amplitude: domain walls give the first (Rayleigh), their saturation the second."""

ORDERS, SOFTENINGS = 0.5, 0.8
"""Shares of the time after which no further order and no further softening is tried: the refinement
of what was found follows."""

RIDGES = (0.0, 1e-2)
"""Ridge parameters of the starts of the softening: none, and one that suppresses gains that the
levels determine to less than a tenth. With many modes the first is unstable."""

FINAL_STEPS = 20
"""Gauss-Newton steps of a model that is kept."""

REWEIGHTINGS = 3
"""Number of reweightings of recordings without scatter by the residual of the refined model. Set on
the simulated flexure, where the misfit then equals the noise to 1 %."""

SLOWEST_POLE = 0.9
"""Rate of the slowest pole over that of the lowest resonance, where there is hysteresis or creep:
slower ones would stand for these. A light mode may still move."""

FURTHER_REFINEMENT = "further refinement"
"""What is omitted once the time is over."""

Note = Callable[[str], object]
Progress = Callable[[str, float], object]


def fitted_modes(
    levels: Sequence[Sequence[Spectrum]], pairs: int | None, note: Note, progress: Progress,
    behind_actuators: bool = False,
) -> tuple[CoupledFit, list[Spectrum], np.ndarray]:
    """Return modes and softening of spectra by rising amplitude, and the latencies of the sensors.

    For the other parameters see `identify_several_axes`. With `behind_actuators`, the drive is that
    of the modes, behind hysteresis and creep.
    """
    start, late = _with_latencies(_reference(levels), pairs, progress)
    levels = [[each.advanced(late) for each in level] for level in levels]
    reference = _reference(levels)
    fit, everything = _best_fit(reference, levels, start, note, progress)
    if behind_actuators:
        numbers = without_slow_poles(fit.numbers, everything)
        highest = max(np.angle(spectrum.z).max() for spectrum in everything)
        # No line shows a resonance beyond the lines; poles there represent hysteresis.
        fit = refined(numbers.with_poles(np.angle(numbers.steps) <= highest), everything,
                      FINAL_STEPS)
    if not all(_is_response(level) for level in levels):
        fit, everything = reweighted_fit(fit, everything, is_open=pairs is None)
        if pairs is None and not len(fit.numbers.back):
            fit, everything = _with_hidden_modes(fit, everything)
    upper = fit.numbers.steps.imag > 0.0
    note(f"{np.count_nonzero(upper)} modes and {np.count_nonzero(~upper)} real poles, shared by "
         "all axes")
    return fit, everything, late


def reweighted_fit(fit: CoupledFit, spectra: Sequence[Spectrum],
                   is_open: bool) -> tuple[CoupledFit, list[Spectrum]]:
    """Return the fit whose deviations are its own residual, with its spectra.

    Beside light modes a model that is not refined leaves many times the noise, where the lines tell
    most of their frequency. If it is open, poles without evidence may be left out.
    """
    with while_time_lasts(FURTHER_REFINEMENT):
        for _ in range(REWEIGHTINGS):
            spectra = [reweighted(each, residual)
                       for each, residual in zip(spectra, fit.residual, strict=True)]
            fit = refined(fit.numbers, spectra, FINAL_STEPS)
            if is_open:
                fit = without_weak_poles(fit, spectra)
            check_cancelled()
    return fit, list(spectra)


def _with_hidden_modes(fit: CoupledFit, spectra: Sequence[Spectrum],
                       ) -> tuple[CoupledFit, list[Spectrum]]:
    """Return the fit with modes so close to others that the search for the order missed them."""
    while has_time_for(FURTHER_REFINEMENT, SOFTENINGS):
        more, weighted = reweighted_fit(
            with_a_further_mode(fit, spectra), spectra, is_open=False)
        if local_evidence_of(more) <= local_evidence_of(fit):
            break
        fit, spectra = more, weighted
    return fit, list(spectra)


def without_slow_poles(numbers: CoupledNumbers, spectra: Sequence[Spectrum]) -> CoupledNumbers:
    """Return the numbers without poles that stand for hysteresis and creep."""
    lowest = lowest_resonance(numbers, spectra)
    return replace(numbers.with_poles(np.abs(np.log(numbers.steps)) >= lowest),
                   slowest=SLOWEST_POLE * lowest)


def lowest_resonance(numbers: CoupledNumbers, spectra: Sequence[Spectrum]) -> float:
    """Return the rate of the slowest light mode that resonates, over the sample rate.

    It resonates if it moves an axis farther at its frequency than all poles do at rest, and if the
    spectra contain `FEWEST_PERIODS` of it: other light poles may stand for hysteresis at a few
    lines. Where none resonates, that of the slowest pole is returned.
    """
    steps, rates = numbers.steps, np.log(numbers.steps)
    light = (steps.imag > 0.0) & (-rates.real < LIGHT * np.abs(rates))
    residues = residues_of(numbers, numbers.gains)
    moved = np.abs(residues).max(axis=(1, 2)) / (1.0 - np.abs(steps))
    at_rest = np.where(steps.imag > 0.0, 2.0, 1.0)[:, None, None] * residues / (
        1.0 - steps[:, None, None])
    lines_apart = min(np.diff(np.angle(each.z), prepend=0.0).min() for each in spectra)
    resonating = (light & (moved > np.abs(at_rest.real.sum(axis=0)).max())
                  & (np.abs(rates) > FEWEST_PERIODS * lines_apart))
    return float(np.abs(rates[resonating] if resonating.any() else rates).min())


def _reference(levels: Sequence[Sequence[Spectrum]]) -> Sequence[Spectrum]:
    """Return the spectra of the middle level that has responses, or of all where none has."""
    responses = [level for level in levels if _is_response(level)]
    if responses:
        return responses[len(responses) // 2]
    return [spectrum for level in levels for spectrum in level]


def _is_response(level: Sequence[Spectrum]) -> bool:
    """Return whether the spectra of a level are its responses to each axis alone."""
    n = level[0].drive.shape[1]
    return len(level) == n and all(
        not each.transient and each.driven == (axis,) and np.all(each.drive[:, axis] == 1.0)
        for axis, each in enumerate(level))


def _with_latencies(reference: Sequence[Spectrum], pairs: int | None,
                    progress: Progress) -> tuple[CoupledFit, np.ndarray]:
    """Return the linear fit with most evidence, and its latencies.

    What lags behind the light modes is late, or it passes a slow amplifier: a pole without delay.
    """
    first = _ordered(reference, pairs, progress)
    best, late = first, np.zeros(reference[0].motion.shape[1], dtype=int)
    for tried in (latencies(reference, first), further_latencies(reference, first)):
        if tried.any():
            fit = _ordered([each.advanced(tried) for each in reference], pairs, progress)
            if evidence_of(fit) > evidence_of(best):
                best, late = fit, tried
    return best, late


def _ordered(reference: Sequence[Spectrum], pairs: int | None, progress: Progress) -> CoupledFit:
    """Return the linear fit of the order with most evidence, or of a given one."""
    if pairs is not None:
        *_, best = growing(reference, pairs)
        return best
    fits = growing(reference, MOST_PAIRS)
    best, worse = next(fits), 0
    for number, fit in enumerate(fits, start=1):
        progress(f"{fit.numbers.steps.size} poles", min(0.5, 0.03 * number))
        gains_evidence = evidence_of(fit) > evidence_of(best)
        best, worse = (fit, 0) if gains_evidence else (best, worse + 1)
        if worse == WORSE_IN_A_ROW or not has_time_for(
                f"more than {fit.numbers.steps.size} poles", ORDERS):
            break
    return best


def _best_fit(
    reference: Sequence[Spectrum], levels: Sequence[Sequence[Spectrum]], start: CoupledFit,
    note: Note, progress: Progress,
) -> tuple[CoupledFit, list[Spectrum]]:
    """Return the fit with most evidence of those that soften and the one that does not."""
    progress("refinement", 0.5)
    linear = refined(start.numbers, reference, JUDGED_STEPS)
    others = [level for level in levels if _is_response(level) and level[0] is not reference[0]]
    everything = [spectrum for level in levels for spectrum in level]
    if not others:
        return refined(linear.numbers, everything, FINAL_STEPS), everything
    fits = [refined(linear.numbers, everything, JUDGED_STEPS)]
    for powers in range(1, min(MOST_POWERS, len(others)) + 1):
        if not has_time_for(f"softening with {powers} powers of the amplitude", SOFTENINGS):
            break
        progress(f"softening, {powers} powers of the amplitude", 0.5 + 0.1 * powers)
        fits += [refined(softened_numbers(linear.numbers, others, powers, ridge), everything,
                         JUDGED_STEPS) for ridge in RIDGES]
    best = max(fits, key=evidence_of)
    powers = len(best.numbers.back)
    note("nothing softens with the amplitude" if not powers else
         f"stiffness, damping and gain depend on the amplitude, {powers} powers of it")
    progress("refinement", 0.7)
    with while_time_lasts(FURTHER_REFINEMENT):
        best = refined(best.numbers, everything, FINAL_STEPS)
        check_cancelled()
    return best, everything
