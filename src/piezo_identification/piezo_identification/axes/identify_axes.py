# SPDX-License-Identifier: BSD-3-Clause
"""Identify one coupled model from recordings of two or three axes."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.budget import Budget
from piezo_identification.axes.coupled_fit import (
    CoupledFit,
    covariances,
    refined,
    softened_numbers,
)
from piezo_identification.axes.coupled_numbers import CoupledNumbers, Linearised
from piezo_identification.axes.order_search import evidence_of, growing
from piezo_identification.axes.predict_axes import SAME_PERIOD, errors_percent
from piezo_identification.axes.sensor_delays import latencies, sensor_delays
from piezo_identification.axes.spectra import (
    Spectrum,
    levels_of,
    reweighted,
    spectra_of_level,
)
from piezo_models.axes.coupled import CoupledModel, Softening
from piezo_models.axes.identified_axes import Coupling, IdentifiedAxes
from piezo_recorder.reading.axes import AxesRecording
from piezo_recorder.reading.recording import RecordingError

MOST_PAIRS = 40
"""Pairs of poles at which the search for the order ends in any case."""

WORSE_IN_A_ROW = 2
"""Orders without more evidence after which the search for the order ends."""

JUDGED_STEPS, FINAL_STEPS = 3, 20
"""Gauss-Newton steps of a model that is compared, and of the one that is kept."""

MOST_POWERS = 2
"""Powers of the amplitude: domain walls give the first (Rayleigh), their saturation the second."""

MEMORIES_S = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Time constants of the running RMS that are compared, three to a decade."""

GENEROUS_PAIRS = 12
"""Pairs of poles of the model whose remainder is taken as the noise of recordings that tell none:
beyond the modes of a stage of three axes below its sample rate, and few against the lines."""

REWEIGHTINGS = 3
"""Of recordings without scatter, by what the refined model leaves; set on the simulated flexure,
where the misfit then is that of the noise to 1 %, from a sixth of it."""

COUPLING_FREQUENCIES = 20
"""Frequencies at which the model file tells the response, beside those of the modes."""

Note = Callable[[str], object]
Progress = Callable[[str, float], object]


def identify_several_axes(
    recordings: Sequence[AxesRecording], validation: Sequence[AxesRecording] = (), *,
    pairs: int | None = None, note: Note = lambda text: None,
    progress: Progress = lambda what, part: None, budget: Budget | None = None,
) -> IdentifiedAxes:
    """Identify modes, coupling and softening from recordings in which one axis or all move.

    Parameters
    ----------
    recordings : sequence of AxesRecording
        Of the same axes and sample period. Every axis must be driven in one of them. Softening is
        sought where there are several levels of more realisations of periods than axes.
    validation : sequence of AxesRecording
        What is not fitted: the errors are measured on it.
    pairs : int, optional
        Pairs of poles; by evidence by default.
    note : callable
        Called with sentences on levels and orders.
    progress : callable
        Called with what is done, and which part of the whole (0 to 1).
    budget : Budget, optional
        When it is over, the best so far is kept; `unfinished` then says what was not tried.

    Raises
    ------
    RecordingError
        If the recordings do not belong together or leave an axis at rest.
    """
    _check(recordings, validation)
    budget = budget or Budget()
    progress("spectra", 0.0)
    levels = [spectra_of_level(level) for level in levels_of(recordings)]
    reference = _reference(levels)
    note(f"{len(recordings)} recordings of {', '.join(recordings[0].axes)} at "
         f"{len(levels)} levels, RMS " + ", ".join(
             f"{level[0].amplitude_v:.3g}" for level in levels) + " V")
    late = latencies(reference)
    levels = [[each.advanced(late) for each in level] for level in levels]
    reference = [each.advanced(late) for each in reference]
    without_scatter = any(each.transient or len(reference) < reference[0].drive.shape[1]
                          for each in reference)
    if without_scatter:
        reference = _with_deviations(reference)
        levels = [reference] if len(levels) == 1 else levels
    start = _ordered(reference, pairs, note, progress, budget)
    fit, everything = _best_fit(reference, levels, start, note, progress, budget)
    if without_scatter:
        fit, everything = _reweighted(fit, everything)
    progress("memory", 0.9)
    return _identified(fit, everything, recordings, validation, late, budget)


def _check(recordings: Sequence[AxesRecording], validation: Sequence[AxesRecording]) -> None:
    if not recordings:
        raise RecordingError("there is nothing to identify: give recordings of several axes")
    first = recordings[0]
    for each in (*recordings, *validation):
        if each.axes != first.axes:
            raise RecordingError(f"{each.name} has the axes {', '.join(each.axes)}, and "
                                 f"{first.name} {', '.join(first.axes)}: give those of one stage")
        if abs(each.sample_period_s / first.sample_period_s - 1.0) > SAME_PERIOD:
            raise RecordingError(
                f"{each.name} has a sample period of {each.sample_period_s:.6g} s, and "
                f"{first.name} of {first.sample_period_s:.6g} s: give recordings of one rate")
    for number, axis in enumerate(first.axes):
        if all(np.ptp(each.voltage_v[:, number]) == 0.0 for each in recordings):
            raise RecordingError(f"no recording moves the axis {axis}: add one that does")


def _reference(levels: list[list[Spectrum]]) -> list[Spectrum]:
    """Return the spectra of the middle level that has responses, or of all where none has."""
    responses = [level for level in levels if _is_response(level)]
    if responses:
        return responses[len(responses) // 2]
    return [spectrum for level in levels for spectrum in level]


def _is_response(level: Sequence[Spectrum]) -> bool:
    """Tell whether the spectra of a level are its responses to each axis alone."""
    n = level[0].drive.shape[1]
    return len(level) == n and all(
        not each.transient and each.driven == (axis,) and np.all(each.drive[:, axis] == 1.0)
        for axis, each in enumerate(level))


def _with_deviations(spectra: Sequence[Spectrum]) -> list[Spectrum]:
    """Return spectra whose deviations are what a model with more than enough poles leaves."""
    for _ in range(2):  # the first one was fitted with deviations as the motion
        *_, generous = growing(spectra, GENEROUS_PAIRS)
        spectra = [reweighted(each, left)
                   for each, left in zip(spectra, generous.left, strict=True)]
    return list(spectra)


def _reweighted(fit: CoupledFit,
                spectra: Sequence[Spectrum]) -> tuple[CoupledFit, list[Spectrum]]:
    """Return the fit whose deviations are what it leaves itself, with its spectra.

    Beside light modes a model that is not refined leaves many times the noise, where the lines tell
    most of their frequency.
    """
    for _ in range(REWEIGHTINGS):
        spectra = [reweighted(each, left) for each, left in zip(spectra, fit.left, strict=True)]
        fit = refined(fit.numbers, spectra, FINAL_STEPS)
    return fit, list(spectra)


def _ordered(reference: Sequence[Spectrum], pairs: int | None, note: Note, progress: Progress,
             budget: Budget) -> CoupledFit:
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
        if worse == WORSE_IN_A_ROW:
            break
        if budget.is_spent(0.5):
            budget.not_tried.append(f"more than {fit.numbers.steps.size} poles")
            break
    upper = best.numbers.steps.imag > 0.0
    note(f"{np.count_nonzero(upper)} modes and {np.count_nonzero(~upper)} real poles, shared by "
         "all axes")
    return best


def _best_fit(
    reference: Sequence[Spectrum], levels: Sequence[Sequence[Spectrum]], start: CoupledFit,
    note: Note, progress: Progress, budget: Budget,
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
        if budget.is_spent(0.8):
            budget.not_tried.append(f"softening with {powers} powers of the amplitude")
            break
        progress(f"softening, {powers} powers of the amplitude", 0.5 + 0.1 * powers)
        fits.append(refined(softened_numbers(linear.numbers, others, powers), everything,
                            JUDGED_STEPS))
    best = max(fits, key=evidence_of)
    powers = len(best.numbers.back)
    note("nothing softens with the amplitude" if not powers else
         f"stiffness, damping and gain depend on the amplitude, {powers} powers of it")
    progress("refinement", 0.7)
    return refined(best.numbers, everything, FINAL_STEPS), everything


def _identified(
    fit: CoupledFit, spectra: Sequence[Spectrum], recordings: Sequence[AxesRecording],
    validation: Sequence[AxesRecording], late: np.ndarray, budget: Budget,
) -> IdentifiedAxes:
    first, numbers = recordings[0], fit.numbers
    period_s, n = first.sample_period_s, len(first.axes)
    samples = [len(each.voltage_v) for each in recordings]
    poles = (np.log(numbers.steps) / period_s).astype(complex)
    model = CoupledModel(
        first.axes, period_s, poles, _residues(numbers, numbers.gains),
        numbers.direct, late,
        np.average([each.voltage_v.mean(axis=0) for each in recordings], axis=0, weights=samples),
        np.average([each.displacement_um.mean(axis=0) for each in recordings], axis=0,
                   weights=samples))
    if len(numbers.back):
        amplitudes_v = [spectrum.amplitude_v for spectrum in spectra]
        model = replace(model, softening=Softening(
            np.array([_residues(numbers, back) for back in numbers.back]), numbers.back_gain,
            numbers.reference_v, MEMORIES_S[-1], (min(amplitudes_v), max(amplitudes_v))))
        model = _with_memory(model, recordings)
    known, columns = covariances(fit, spectra), numbers.gains.shape[0]
    gain_deviations = np.sqrt(np.array([
        np.diag(each)[: columns * n].reshape(columns, n) for each in known]).transpose(1, 0, 2))
    off = np.sqrt(np.diag(known[0])[numbers.own().shape[1]:][:columns])
    pairs = int(np.count_nonzero(numbers.steps.imag > 0.0))
    pole_deviations = (np.concatenate([
        off[0:2 * pairs:2] + 1j * off[1:2 * pairs:2], off[2 * pairs:]]) / period_s).astype(complex)
    residue_deviations = _residues(numbers, gain_deviations)
    delays_s, delay_deviations_s = sensor_delays(model, residue_deviations)
    return IdentifiedAxes(
        model, np.array([[min(each.voltage_v[:, axis].min() for each in recordings),
                          max(each.voltage_v[:, axis].max() for each in recordings)]
                         for axis in range(n)]),
        _coupling(numbers, known, model), pole_deviations, residue_deviations, delays_s,
        delay_deviations_s, errors_percent(model, validation) if validation else {},
        [{"path": each.name, "sha256": each.sha256} for each in recordings],
        unfinished=budget.sentence())


def _residues(numbers: CoupledNumbers, gains: FloatArray) -> ComplexArray:
    """Return the residues that gains of `mode_basis` stand for, one of each pair first."""
    pairs = 2 * int(np.count_nonzero(numbers.steps.imag > 0.0))
    return np.concatenate([gains[0:pairs:2] + 1j * gains[1:pairs:2], gains[pairs:].astype(complex)])


def _with_memory(model: CoupledModel, recordings: Sequence[AxesRecording]) -> CoupledModel:
    """Return the model with the memory that explains one recording of each level best."""
    assert model.softening is not None
    judged = [level[0] for level in levels_of(recordings)]
    candidates = [replace(model, softening=replace(model.softening, memory_s=memory_s))
                  for memory_s in MEMORIES_S]
    return min(candidates, key=lambda candidate: sum(
        error["e_y_percent"] for each in judged
        for error in errors_percent(candidate, [each]).values()))


def _coupling(numbers: CoupledNumbers, known: Sequence[FloatArray],
              model: CoupledModel) -> Coupling:
    """Return the response at some frequencies with its deviations."""
    n, nyquist_hz = len(model.axes), 0.5 / model.sample_period_s
    of_modes = np.abs(model.poles_rad_per_s[model.poles_rad_per_s.imag > 0.0]) / (2.0 * np.pi)
    lowest_hz = min(1e-3 * nyquist_hz, of_modes.min(initial=nyquist_hz) / 10.0)
    frequency_hz = np.unique(np.concatenate([
        np.geomspace(lowest_hz, 0.9 * nyquist_hz, COUPLING_FREQUENCIES),
        of_modes[of_modes < nyquist_hz]]))
    z = np.exp(2j * np.pi * frequency_hz * model.sample_period_s)
    deviation = np.zeros((z.size, n, n), dtype=complex)
    for axis in range(n):
        alone = Spectrum(z, np.tile(np.eye(n)[axis], (z.size, 1)).astype(complex),
                         np.zeros((z.size, n), complex), np.ones((z.size, n)),
                         numbers.reference_v, transient=False)
        at = Linearised(numbers, alone)
        own, shared = at.own_slopes(), at.shared_slopes()
        for output, covariance in enumerate(known):
            late = z[:, None] ** -int(model.latency_samples[output])
            slopes = late * np.hstack([own, shared[output]])
            deviation[:, output, axis] = (
                _spread(slopes.real, covariance) + 1j * _spread(slopes.imag, covariance))
    return Coupling(frequency_hz, model.response(frequency_hz), deviation)


def _spread(slopes: FloatArray, covariance: FloatArray) -> FloatArray:
    spread: FloatArray = np.sqrt(np.maximum(np.einsum("kp,pq,kq->k", slopes, covariance, slopes,
                                                      optimize=True), 0.0))
    return spread
