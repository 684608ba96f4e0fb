# SPDX-License-Identifier: BSD-3-Clause
"""Identify one coupled model from recordings of two or three axes."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.budget import Budget
from piezo_identification.axes.actuator_numbers import ActuatorNumbers
from piezo_identification.axes.all_together import (
    FINAL_STEPS,
    JUDGED_STEPS,
    coupled_model,
    fitted_together,
    residues_of,
    reweighted_fit,
)
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

MOST_POWERS = 2
"""Powers of the amplitude: domain walls give the first (Rayleigh), their saturation the second."""

RIDGES = (0.0, 1e-2)
"""Of the starts of the softening: none, and one that leaves out what the levels tell to less than a
tenth. With many modes the first is unstable, and is reduced to little."""

MEMORIES_S = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Time constants of the running RMS that are compared, three to a decade."""

COUPLING_FREQUENCIES = 20
"""Frequencies at which the model file tells the response, beside those of the modes."""

Note = Callable[[str], object]
Progress = Callable[[str, float], object]


def identify_several_axes(
    dynamics: Sequence[AxesRecording], validation: Sequence[AxesRecording] = (), *,
    creep: Sequence[AxesRecording] = (), hysteresis: Sequence[AxesRecording] = (),
    pairs: int | None = None, note: Note = lambda text: None,
    progress: Progress = lambda what, part: None, budget: Budget | None = None,
) -> IdentifiedAxes:
    """Identify modes, coupling, softening, and hysteresis and creep of each axis.

    In each recording one axis moves, or several do. Every axis must be driven in one of them.

    Parameters
    ----------
    dynamics : sequence of AxesRecording
        Fast ones, of the same axes and sample period. Softening is sought where there are several
        levels of more realisations of periods than axes.
    validation : sequence of AxesRecording
        What is not fitted: the errors are measured on it.
    creep, hysteresis : sequence of AxesRecording
        Slow ones, of the same sample period or longer ones. Hysteresis and creep are sought in
        them; where one of the two is not given, in the other one.
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
    recordings = [*dynamics, *creep, *hysteresis]
    _check(recordings, dynamics, validation)
    budget = budget or Budget()
    shortest_s = min(each.sample_period_s for each in recordings)
    fast = list(dynamics) or [each for each in recordings if _is_of_period(each, shortest_s)]
    fit, spectra, late = _fitted_modes(fast, pairs, note, progress, budget)
    together = None
    if creep or hysteresis:
        together = fitted_together(
            fit, late, {"dynamics": dynamics, "creep": creep, "hysteresis": hysteresis}, fast, note,
            progress, budget, is_open=pairs is None)
        alike = [each for each in recordings if _is_of_period(each, fast[0].sample_period_s)]
        if together is None and len(alike) > len(fast):
            fast = alike
            fit, spectra, late = _fitted_modes(fast, pairs, note, progress, budget)
    fit, spectra, model = together or (fit, spectra, coupled_model(fit.numbers, late, fast))
    progress("memory", 0.9)
    return _identified(fit, spectra, model, fast, recordings, validation, budget)


def _is_of_period(recording: AxesRecording, sample_period_s: float) -> bool:
    return abs(recording.sample_period_s / sample_period_s - 1.0) <= SAME_PERIOD


def _fitted_modes(
    recordings: Sequence[AxesRecording], pairs: int | None, note: Note, progress: Progress,
    budget: Budget,
) -> tuple[CoupledFit, list[Spectrum], np.ndarray]:
    """Return modes and softening of fast recordings, and the latencies of the sensors."""
    progress("spectra", 0.0)
    levels = [spectra_of_level(level) for level in levels_of(recordings)]
    reference = _reference(levels)
    note(f"{len(recordings)} recordings of {', '.join(recordings[0].axes)} at "
         f"{len(levels)} levels, RMS " + ", ".join(
             f"{level[0].amplitude_v:.3g}" for level in levels) + " V")
    start = _ordered(reference, pairs, progress, budget)
    late = latencies(reference, start)
    if late.any():
        levels = [[each.advanced(late) for each in level] for level in levels]
        reference = [each.advanced(late) for each in reference]
        start = _ordered(reference, pairs, progress, budget)
    fit, everything = _best_fit(reference, levels, start, note, progress, budget)
    if not all(_is_response(level) for level in levels):
        fit, everything = reweighted_fit(fit, everything, is_open=pairs is None)
    upper = fit.numbers.steps.imag > 0.0
    note(f"{np.count_nonzero(upper)} modes and {np.count_nonzero(~upper)} real poles, shared by "
         "all axes")
    return fit, everything, late


def _check(recordings: Sequence[AxesRecording], dynamics: Sequence[AxesRecording],
           validation: Sequence[AxesRecording]) -> None:
    if not recordings:
        raise RecordingError("there is nothing to identify: give recordings of several axes")
    first = dynamics[0] if dynamics else min(recordings, key=lambda each: each.sample_period_s)
    for each in (*recordings, *validation):
        if each.axes != first.axes:
            raise RecordingError(f"{each.name} has the axes {', '.join(each.axes)}, and "
                                 f"{first.name} {', '.join(first.axes)}: give those of one stage")
        if not _is_of_period(each, first.sample_period_s) and (
                each in dynamics or each.sample_period_s < first.sample_period_s):
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


def _ordered(reference: Sequence[Spectrum], pairs: int | None, progress: Progress,
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
        fits += [refined(softened_numbers(linear.numbers, others, powers, ridge), everything,
                         JUDGED_STEPS) for ridge in RIDGES]
    best = max(fits, key=evidence_of)
    powers = len(best.numbers.back)
    note("nothing softens with the amplitude" if not powers else
         f"stiffness, damping and gain depend on the amplitude, {powers} powers of it")
    progress("refinement", 0.7)
    return refined(best.numbers, everything, FINAL_STEPS), everything


def _identified(
    fit: CoupledFit, spectra: Sequence[Spectrum], model: CoupledModel,
    fast: Sequence[AxesRecording], recordings: Sequence[AxesRecording],
    validation: Sequence[AxesRecording], budget: Budget,
) -> IdentifiedAxes:
    numbers, period_s, n = fit.numbers, model.sample_period_s, len(model.axes)
    if len(numbers.back):
        amplitudes_v = [spectrum.amplitude_v for spectrum in spectra]
        model = replace(model, softening=Softening(
            np.array([residues_of(numbers, back) for back in numbers.back]), numbers.back_gain,
            numbers.reference_v, MEMORIES_S[-1], (min(amplitudes_v), max(amplitudes_v))))
        model = _with_memory(model, fast)
    known, columns = covariances(fit, spectra), numbers.gains.shape[0]
    gain_deviations = np.sqrt(np.array([
        np.diag(each)[: columns * n].reshape(columns, n) for each in known]).transpose(1, 0, 2))
    off = np.sqrt(np.diag(known[0])[numbers.own().shape[1]:][:columns])
    pairs = int(np.count_nonzero(numbers.steps.imag > 0.0))
    pole_deviations = (np.concatenate([
        off[0:2 * pairs:2] + 1j * off[1:2 * pairs:2], off[2 * pairs:]]) / period_s).astype(complex)
    residue_deviations = residues_of(numbers, gain_deviations)
    delays_s, delay_deviations_s = sensor_delays(model, residue_deviations)
    return IdentifiedAxes(
        model, np.array([[min(each.voltage_v[:, axis].min() for each in recordings),
                          max(each.voltage_v[:, axis].max() for each in recordings)]
                         for axis in range(n)]),
        _coupling(numbers, known, model), pole_deviations, residue_deviations, delays_s,
        delay_deviations_s, errors_percent(model, validation) if validation else {},
        [{"path": each.name, "sha256": each.sha256} for each in recordings],
        unfinished=budget.sentence())


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
        at = Linearised(replace(numbers, actuators=ActuatorNumbers()), alone)
        own, shared = at.own_slopes(), at.shared_slopes()
        for output, covariance in enumerate(known):
            late = z[:, None] ** -int(model.latency_samples[output])
            slopes = late * np.hstack([own, shared[output]])
            covariance = covariance[: slopes.shape[1], : slopes.shape[1]]
            deviation[:, output, axis] = (
                _spread(slopes.real, covariance) + 1j * _spread(slopes.imag, covariance))
    return Coupling(frequency_hz, model.response(frequency_hz), deviation)


def _spread(slopes: FloatArray, covariance: FloatArray) -> FloatArray:
    spread: FloatArray = np.sqrt(np.maximum(np.einsum("kp,pq,kq->k", slopes, covariance, slopes,
                                                      optimize=True), 0.0))
    return spread
