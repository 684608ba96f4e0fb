# SPDX-License-Identifier: BSD-3-Clause
"""Identify one coupled model from recordings of two or three axes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.budget import Budget, spending
from piezo_identification.axes.actuator_start import start_of_actuators
from piezo_identification.axes.axes_response import AxesResponse
from piezo_identification.axes.coupled_fit import CoupledFit, covariances, covariances_of_correlated
from piezo_identification.axes.coupled_numbers import CoupledNumbers, Linearised
from piezo_identification.axes.modal_model import coupled_model, modal_model, residues_of
from piezo_identification.axes.modes_fit import Note, Progress, fitted_modes
from piezo_identification.axes.order_search import without_weak_poles
from piezo_identification.axes.predict_axes import SAME_PERIOD, errors_percent
from piezo_identification.axes.sensor_delays import further_latencies, sensor_delays
from piezo_identification.axes.spectra import (
    Spectrum,
    levels_of,
    response_to,
    spectra_of_levels,
    spectra_of_response,
    weight_by_residual,
)
from piezo_identification.axes.whole_axes_fit import FittedStage, fit_to_all
from piezo_identification.identification.estimated_loops import ANY_VOLTAGE_V
from piezo_models.axes.coupled import CoupledModel, Softening
from piezo_models.axes.identified_axes import Coupling, IdentifiedAxes
from piezo_recorder.reading.axes import AxesRecording
from piezo_recorder.reading.recording import RecordingError

MEMORIES_S = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Time constants of the running RMS that are compared, three to a decade."""

NOISE_ROUNDS = 3
"""Fits of a response of unknown deviations; each takes those that the one before left."""

COUPLING_FREQUENCIES = 20
"""Frequencies, in addition to those of the modes, at which the model file gives the response."""


def identify_several_axes(
    dynamics: Sequence[AxesRecording] | AxesResponse,
    validation: Sequence[AxesRecording] = (), *,
    creep: Sequence[AxesRecording] = (), hysteresis: Sequence[AxesRecording] = (),
    pairs: int | None = None, note: Note = lambda text: None,
    progress: Progress = lambda what, part: None, budget: Budget | None = None,
) -> IdentifiedAxes:
    """Identify modes, coupling, softening, and hysteresis and creep of each axis.

    In each recording one axis moves, or several do. Every axis must be driven in one of them.

    Parameters
    ----------
    dynamics : sequence of AxesRecording, or AxesResponse
        Fast ones, of the same axes and sample period. Softening is sought where there are several
        levels of more realisations of periods than axes. Or a measured frequency response, which
        gives modes alone.
    validation : sequence of AxesRecording
        What is not fitted: the errors are measured on it.
    creep, hysteresis : sequence of AxesRecording
        Slow ones, of the same sample period or longer ones. Hysteresis and creep are sought in
        them; where one of the two is not given, in the other one.
    pairs : int, optional
        Pairs of poles; by evidence by default.
    note : callable
        Called with sentences on the levels and orders of recordings.
    progress : callable
        Called with what is done, and which part of the whole (0 to 1).
    budget : Budget, optional
        When it is over, the best so far is kept; `unfinished` then says what was not tried.

    Raises
    ------
    RecordingError
        If the recordings do not belong together or leave an axis at rest.

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> from piezo_identification import AxesResponse
    >>> mode = [1e-6, 1e-4, 1.0]
    >>> stage = control.tf([[[1.0], [0.1]], [[0.1], [2.0]]], [[mode, mode], [mode, mode]])
    >>> identified = identify_several_axes(AxesResponse.from_control(
    ...     control.frequency_response(stage, np.geomspace(10.0, 3000.0, 30))), pairs=1)
    >>> print(np.round(np.abs(identified.model.poles_rad_per_s)))
    [1000.]
    """
    budget = budget or Budget()
    with spending(budget):
        if isinstance(dynamics, AxesResponse):
            if creep or hysteresis:
                raise RecordingError(f"{dynamics.name} is a frequency response, beside which creep "
                                     "and hysteresis are not estimated: leave them out")
            identified = _of_response(dynamics, validation, pairs, progress)
        else:
            identified = _of_recordings(
                {"dynamics": dynamics, "creep": creep, "hysteresis": hysteresis}, validation,
                pairs, note, progress)
    errors = errors_percent(identified.model, validation) if validation else {}
    return replace(identified, errors=errors, unfinished=budget.sentence())


def _of_response(
    response: AxesResponse, validation: Sequence[AxesRecording], pairs: int | None,
    progress: Progress,
) -> IdentifiedAxes:
    for each in validation:
        _check_alike(each, response)
    n, measured = len(response.axes), spectra_of_response(response)
    rounds = NOISE_ROUNDS if response.known_deviation() is None else 1
    for done in range(rounds):
        def progress_of_round(what: str, part: float, done: int = done) -> None:
            progress(what, (done + part) / rounds)

        fit, spectra, late = _fitted_response(measured, pairs, progress_of_round)
        measured = [replace(each, weight=weight_by_residual(fitted, residual))
                    for each, fitted, residual in zip(measured, spectra, fit.residual, strict=True)]
    model = modal_model(fit.numbers, late, response.axes, response.sample_period_s)
    known, covariance = covariances(fit, spectra), response.covariance_um2_per_v2
    if covariance is not None:
        turn = response.hold_gain()[:, None] * spectra[0].z[:, None] ** late
        known = covariances_of_correlated(fit, spectra, np.einsum(
            "km,kmdij,ki->kmdij", turn, covariance, turn.conj()))
    return _identified(FittedStage(fit.numbers, model, known),
                       np.tile([-ANY_VOLTAGE_V, ANY_VOLTAGE_V], (n, 1)), [response])


def _fitted_response(measured: Sequence[Spectrum], pairs: int | None, progress: Progress,
                     ) -> tuple[CoupledFit, list[Spectrum], np.ndarray]:
    """Return modes and latencies of a response, which are sought again with all modes known."""
    late = np.zeros(measured[0].motion.shape[1], dtype=int)
    while True:
        fit, spectra, own = fitted_modes(
            [[each.advanced(late) for each in measured]], pairs, lambda text: None, progress)
        if pairs is None:
            fit = without_weak_poles(fit, spectra)
        more = further_latencies(spectra, fit)
        late = late + own + more
        if not more.any():
            return fit, spectra, late


def _of_recordings(
    by_experiment: Mapping[str, Sequence[AxesRecording]], validation: Sequence[AxesRecording],
    pairs: int | None, note: Note, progress: Progress,
) -> IdentifiedAxes:
    recordings = [each for listed in by_experiment.values() for each in listed]
    dynamics = by_experiment["dynamics"]
    _check(recordings, dynamics, validation)
    shortest_s = min(each.sample_period_s for each in recordings)
    fast = list(dynamics) or [each for each in recordings if _is_of_period(each, shortest_s)]
    fit, spectra, late = _fitted_modes(fast, pairs, note, progress)
    started = None
    if by_experiment["creep"] or by_experiment["hysteresis"]:
        started = start_of_actuators(
            fit, spectra, late, by_experiment, fast, pairs, note, progress)
        alike = [each for each in recordings if _is_of_period(each, fast[0].sample_period_s)]
        if started is None and len(alike) > len(fast):
            fast = alike
            fit, spectra, late = _fitted_modes(fast, pairs, note, progress)
    model = coupled_model(fit.numbers, late, fast)
    if started is not None:
        fit, spectra, model = started.fit, started.spectra, started.model
    if len(fit.numbers.back):
        progress("memory", 0.8)
        model = _with_softening(model, fit.numbers, spectra, fast)
    stage = FittedStage(fit.numbers, model, covariances(fit, spectra))
    if model.actuators:
        progress("all parameters", 0.8)
        stage = fit_to_all(stage, recordings)
    n = len(fast[0].axes)
    voltage_range_v = np.array([[min(each.voltage_v[:, axis].min() for each in recordings),
                                 max(each.voltage_v[:, axis].max() for each in recordings)]
                                for axis in range(n)])
    return _identified(stage, voltage_range_v, recordings)


def _fitted_modes(recordings: Sequence[AxesRecording], pairs: int | None, note: Note,
                  progress: Progress) -> tuple[CoupledFit, list[Spectrum], np.ndarray]:
    progress("spectra", 0.0)
    levels = spectra_of_levels(recordings)
    note(f"{len(recordings)} recordings of {', '.join(recordings[0].axes)} at "
         f"{len(levels)} levels, RMS " + ", ".join(
             f"{level[0].amplitude_v:.3g}" for level in levels) + " V")
    return fitted_modes(levels, pairs, note, progress)


def _is_of_period(recording: AxesRecording, sample_period_s: float) -> bool:
    return abs(recording.sample_period_s / sample_period_s - 1.0) <= SAME_PERIOD


def _check(recordings: Sequence[AxesRecording], dynamics: Sequence[AxesRecording],
           validation: Sequence[AxesRecording]) -> None:
    if not recordings:
        raise RecordingError("there is nothing to identify: give recordings of several axes")
    first = dynamics[0] if dynamics else min(recordings, key=lambda each: each.sample_period_s)
    for each in (*recordings, *validation):
        _check_alike(each, first, exactly=each in dynamics)
    for number, axis in enumerate(first.axes):
        if all(np.ptp(each.voltage_v[:, number]) == 0.0 for each in recordings):
            raise RecordingError(f"no recording moves the axis {axis}: add one that does")


def _check_alike(recording: AxesRecording, first: AxesRecording | AxesResponse,
                 exactly: bool = False) -> None:
    """Refuse a recording of other axes or of a shorter sample period; of any other, if wanted."""
    if recording.axes != first.axes:
        raise RecordingError(f"{recording.name} has the axes {', '.join(recording.axes)}, and "
                             f"{first.name} {', '.join(first.axes)}: give those of one stage")
    if not _is_of_period(recording, first.sample_period_s) and (
            exactly or recording.sample_period_s < first.sample_period_s):
        raise RecordingError(
            f"{recording.name} has a sample period of {recording.sample_period_s:.6g} s, and "
            f"{first.name} of {first.sample_period_s:.6g} s: give recordings of one rate")


def _identified(found: FittedStage, voltage_range_v: FloatArray,
                sources: Sequence[AxesRecording | AxesResponse]) -> IdentifiedAxes:
    """Return the model with its deviations."""
    numbers, model = found.numbers, found.model
    period_s, n, columns = model.sample_period_s, len(model.axes), numbers.gains.shape[0]
    # Rounding makes the variance of what is not determined negative.
    deviations = np.sqrt(np.maximum([np.diag(each) for each in found.known], 0.0))
    gain_deviations = deviations[:, : columns * n].reshape(n, columns, n).transpose(1, 0, 2)
    off = deviations[0, numbers.own().shape[1]:][:columns]
    pairs = int(np.count_nonzero(numbers.steps.imag > 0.0))
    pole_deviations = (np.concatenate([
        off[0:2 * pairs:2] + 1j * off[1:2 * pairs:2], off[2 * pairs:]]) / period_s).astype(complex)
    residue_deviations = residues_of(numbers, gain_deviations)
    delays_s, delay_deviations_s = sensor_delays(model, residue_deviations)
    return IdentifiedAxes(
        model, voltage_range_v, _coupling(found), pole_deviations, residue_deviations,
        delays_s, delay_deviations_s,
        recordings=[{"path": each.name, "sha256": each.sha256} for each in sources])


def _with_softening(model: CoupledModel, numbers: CoupledNumbers, spectra: Sequence[Spectrum],
                    recordings: Sequence[AxesRecording]) -> CoupledModel:
    """Return the model with the memory that explains one recording of each level best."""
    amplitudes_v = [each.amplitude_v for each in spectra]
    softening = Softening(
        np.array([residues_of(numbers, back) for back in numbers.back]), numbers.back_gain,
        numbers.reference_v, MEMORIES_S[-1], (min(amplitudes_v), max(amplitudes_v)))
    judged = [level[0] for level in levels_of(recordings)]
    candidates = [replace(model, softening=replace(softening, memory_s=memory_s))
                  for memory_s in MEMORIES_S]
    return min(candidates, key=lambda candidate: sum(
        error["e_y_percent"] for each in judged
        for error in errors_percent(candidate, [each]).values()))


def _coupling(found: FittedStage) -> Coupling:
    """Return the response at some frequencies with its deviations."""
    numbers, model = found.numbers, found.model
    n, nyquist_hz = len(model.axes), 0.5 / model.sample_period_s
    of_modes = np.abs(model.poles_rad_per_s[model.poles_rad_per_s.imag > 0.0]) / (2.0 * np.pi)
    lowest_hz = min(1e-3 * nyquist_hz, of_modes.min(initial=nyquist_hz) / 10.0)
    frequency_hz = np.unique(np.concatenate([
        np.geomspace(lowest_hz, 0.9 * nyquist_hz, COUPLING_FREQUENCIES),
        of_modes[of_modes < nyquist_hz]]))
    z = np.exp(2j * np.pi * frequency_hz * model.sample_period_s)
    deviation = np.zeros((z.size, n, n), dtype=complex)
    for axis in range(n):
        at = Linearised(numbers, response_to(axis, z, np.zeros((z.size, n), complex),
                                             np.ones((z.size, n)), numbers.reference_v))
        own, shared = at.own_slopes(), at.shared_slopes()
        for output, covariance in enumerate(found.known):
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
