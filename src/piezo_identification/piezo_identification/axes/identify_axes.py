# SPDX-License-Identifier: BSD-3-Clause
"""Identify one coupled model from recordings of two or three axes."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.budget import Budget, spending
from piezo_identification.axes.actuator_rounds import (
    FittedStage,
    coupled_model,
    in_rounds,
    residues_of,
)
from piezo_identification.axes.coupled_fit import covariances
from piezo_identification.axes.coupled_numbers import Linearised
from piezo_identification.axes.modes_fit import Note, Progress, fitted_modes
from piezo_identification.axes.predict_axes import SAME_PERIOD, errors_percent
from piezo_identification.axes.sensor_delays import sensor_delays
from piezo_identification.axes.spectra import Spectrum, levels_of
from piezo_models.axes.coupled import CoupledModel, Softening
from piezo_models.axes.identified_axes import Coupling, IdentifiedAxes
from piezo_recorder.reading.axes import AxesRecording
from piezo_recorder.reading.recording import RecordingError

MEMORIES_S = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Time constants of the running RMS that are compared, three to a decade."""

COUPLING_FREQUENCIES = 20
"""Frequencies, in addition to those of the modes, at which the model file gives the response."""


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
    budget = budget or Budget()
    with spending(budget):
        identified = _identify({"dynamics": dynamics, "creep": creep, "hysteresis": hysteresis},
                               validation, pairs, note, progress)
    return replace(identified, unfinished=budget.sentence())


def _identify(
    by_experiment: Mapping[str, Sequence[AxesRecording]], validation: Sequence[AxesRecording],
    pairs: int | None, note: Note, progress: Progress,
) -> IdentifiedAxes:
    recordings = [each for listed in by_experiment.values() for each in listed]
    dynamics = by_experiment["dynamics"]
    _check(recordings, dynamics, validation)
    shortest_s = min(each.sample_period_s for each in recordings)
    fast = list(dynamics) or [each for each in recordings if _is_of_period(each, shortest_s)]
    fit, spectra, late = fitted_modes(fast, pairs, note, progress)
    whole = None
    if by_experiment["creep"] or by_experiment["hysteresis"]:
        whole = in_rounds(fit, late, by_experiment, fast, pairs, note, progress)
        alike = [each for each in recordings if _is_of_period(each, fast[0].sample_period_s)]
        if whole is None and len(alike) > len(fast):
            fast = alike
            fit, spectra, late = fitted_modes(fast, pairs, note, progress)
    progress("memory", 0.9)
    whole = whole or FittedStage(fit, spectra, coupled_model(fit.numbers, late, fast),
                                 np.zeros(len(fast[0].axes)))
    return _identified(whole, fast, recordings, validation)


def _is_of_period(recording: AxesRecording, sample_period_s: float) -> bool:
    return abs(recording.sample_period_s / sample_period_s - 1.0) <= SAME_PERIOD


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


def _identified(
    found: FittedStage, fast: Sequence[AxesRecording], recordings: Sequence[AxesRecording],
    validation: Sequence[AxesRecording],
) -> IdentifiedAxes:
    fit, spectra, model = found.fit, found.spectra, found.model
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
        _coupling(found, known), pole_deviations, residue_deviations, delays_s,
        delay_deviations_s, errors_percent(model, validation) if validation else {},
        [{"path": each.name, "sha256": each.sha256} for each in recordings])


def _with_memory(model: CoupledModel, recordings: Sequence[AxesRecording]) -> CoupledModel:
    """Return the model with the memory that explains one recording of each level best."""
    assert model.softening is not None
    judged = [level[0] for level in levels_of(recordings)]
    candidates = [replace(model, softening=replace(model.softening, memory_s=memory_s))
                  for memory_s in MEMORIES_S]
    return min(candidates, key=lambda candidate: sum(
        error["e_y_percent"] for each in judged
        for error in errors_percent(candidate, [each]).values()))


def _coupling(found: FittedStage, known: Sequence[FloatArray]) -> Coupling:
    """Return the response at some frequencies with its deviations."""
    numbers, model = found.fit.numbers, found.model
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
            covariance = covariance[: slopes.shape[1], : slopes.shape[1]]
            deviation[:, output, axis] = (
                _spread(slopes.real, covariance) + 1j * _spread(slopes.imag, covariance))
    response = model.response(frequency_hz)
    off = response * found.scale_off
    return Coupling(frequency_hz, response, np.hypot(deviation.real, off.real)
                    + 1j * np.hypot(deviation.imag, off.imag))


def _spread(slopes: FloatArray, covariance: FloatArray) -> FloatArray:
    spread: FloatArray = np.sqrt(np.maximum(np.einsum("kp,pq,kq->k", slopes, covariance, slopes,
                                                      optimize=True), 0.0))
    return spread
