# SPDX-License-Identifier: BSD-3-Clause
"""One fit of hysteresis, creep and modes of several axes to all of their recordings."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.budget import Budget
from piezo_identification.axes.actuator_estimate import estimate_actuators
from piezo_identification.axes.actuator_numbers import ActuatorNumbers, Driven
from piezo_identification.axes.coupled_fit import CoupledFit, linear_numbers, refined
from piezo_identification.axes.coupled_numbers import CoupledNumbers
from piezo_identification.axes.order_search import evidence_of, without_weak_poles
from piezo_identification.axes.predict_axes import (
    circumstances_of,
    predict_several_axes,
    rows_apart,
    simulated_um,
)
from piezo_identification.axes.spectra import Spectrum, reweighted, spectrum_of
from piezo_identification.estimators.estimate import creep_of_partial_fractions
from piezo_identification.estimators.hysteresis.density_estimate import DensityEstimate
from piezo_identification.fitting.free_parameters import changed_model, lowest_changes, pieces_of
from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled import CoupledModel
from piezo_models.axes.identified_axes import LIGHT
from piezo_models.cascade import StageModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.axes import AxesRecording

FINAL_STEPS = 20
"""Gauss-Newton steps of a model that is kept."""

REWEIGHTINGS = 3
"""Of recordings without scatter, by what the refined model leaves; set on the simulated flexure,
where the misfit then is that of the noise to 1 %, from a sixth of it."""

JUDGED_STEPS = 3
"""Those of a model that is compared."""

TRIED_RATES, LEAST_CREEP = 3, 1e-3
"""Rates at which further creep is begun, evenly on a logarithmic scale between the longest
recording and the slowest mode, and its part of the motion."""

LEVELS_OF_ROUNDS = (12, 50, 50, 50)
"""Levels of the hysteresis in each round. In the first more would follow errors of the modes; most
stages need two, those whose creep is as large as their hysteresis more."""

SHARE = 0.8
"""Of the time, after which no further round begins."""

WORTHWHILE = 0.5
"""Logarithm by which the mean square that is left of each recording falls, on average, in a round
that another one follows."""

SLOWEST_CREEP, FASTEST_CREEP, SLOWEST_POLE = 0.3, 0.03, 0.9
"""Rates of creep: the least over that of the longest recording, as that of one axis; the largest
over the lowest resonance, whose hysteresis and creep poles between would stand for. No pole is
slower than the last part of it, so that a light mode may still move."""


def with_drive(recording: AxesRecording, actuators: Sequence[Actuator]) -> AxesRecording:
    """Return a recording with the drive of the modes in place of its voltage."""
    if not actuators:
        return recording
    periods = recording.periods or 1
    return replace(recording, voltage_v=np.column_stack([
        np.tile(actuator.drive_v(
            np.ascontiguousarray(column.reshape(periods, -1).mean(axis=0)),
            recording.sample_period_s, bool(recording.periods)), periods)
        for actuator, column in zip(actuators, recording.voltage_v.T, strict=True)]))


def coupled_model(numbers: CoupledNumbers, late: np.ndarray, driven: Sequence[AxesRecording],
                  actuators: tuple[Actuator, ...] = ()) -> CoupledModel:
    """Return the model of some numbers, without softening.

    Parameters
    ----------
    late : (n,) array of int
        Latency of each sensor.
    driven : sequence of AxesRecording
        Fast ones, with the drive in place of their voltage.
    """
    first, samples = driven[0], [len(each.voltage_v) for each in driven]
    poles = (np.log(numbers.steps) / first.sample_period_s).astype(complex)
    return CoupledModel(
        first.axes, first.sample_period_s, poles, residues_of(numbers, numbers.gains),
        numbers.direct, late,
        np.average([each.voltage_v.mean(axis=0) for each in driven], axis=0, weights=samples),
        np.average([each.displacement_um.mean(axis=0) for each in driven], axis=0,
                   weights=samples), actuators=actuators)


def residues_of(numbers: CoupledNumbers, gains: FloatArray) -> ComplexArray:
    """Return the residues that gains of `mode_basis` stand for, one of each pair first."""
    pairs = 2 * int(np.count_nonzero(numbers.steps.imag > 0.0))
    return np.concatenate([gains[0:pairs:2] + 1j * gains[1:pairs:2], gains[pairs:].astype(complex)])


def reweighted_fit(fit: CoupledFit, spectra: Sequence[Spectrum],
                   is_open: bool) -> tuple[CoupledFit, list[Spectrum]]:
    """Return the fit whose deviations are what it leaves itself, with its spectra.

    Beside light modes a model that is not refined leaves many times the noise, where the lines tell
    most of their frequency.

    Parameters
    ----------
    is_open : bool
        Poles without evidence may be left out.
    """
    for _ in range(REWEIGHTINGS):
        fit, spectra = _reweighted(fit, spectra)
        if is_open:
            fit = without_weak_poles(fit, spectra, JUDGED_STEPS)
    return fit, list(spectra)


def _reweighted(fit: CoupledFit,
                spectra: Sequence[Spectrum]) -> tuple[CoupledFit, list[Spectrum]]:
    spectra = [reweighted(each, left) for each, left in zip(spectra, fit.left, strict=True)]
    return refined(fit.numbers, spectra, FINAL_STEPS), spectra


def fitted_together(
    fit: CoupledFit, late: np.ndarray, by_experiment: Mapping[str, Sequence[AxesRecording]],
    fast: Sequence[AxesRecording], note: Callable[[str], object],
    progress: Callable[[str, float], object], budget: Budget, is_open: bool,
) -> tuple[CoupledFit, list[Spectrum], CoupledModel] | None:
    """Fit modes, hysteresis and creep to all recordings.

    Each round begins with hysteresis and creep as slow recordings show them beside all else that is
    known by then: at first the modes as fitted without them.

    Parameters
    ----------
    fit : CoupledFit
        Of the modes alone.
    by_experiment : mapping of str to sequence of AxesRecording
        "dynamics", "creep" and "hysteresis".
    fast : sequence of AxesRecording
        Those of the shortest sample period.
    note : callable
        Called with what was found of each axis.
    progress : callable
        Called with (stage, fraction) when a stage begins.
    budget : Budget
        Time after which no further round begins.
    is_open : bool
        Poles without evidence may be left out.

    Returns
    -------
    fit : CoupledFit
    spectra : list of Spectrum
        That were fitted.
    model : CoupledModel

    None instead where no axis shows hysteresis or creep.
    """
    recordings = [each for listed in by_experiment.values() for each in listed]
    loops = by_experiment["hysteresis"] or by_experiment["creep"]
    steps = by_experiment["creep"] or by_experiment["hysteresis"]
    lowest = _lowest_resonance(fit.numbers.steps)
    # Slower ones stand for hysteresis and creep.
    numbers = replace(fit.numbers.with_poles(np.abs(np.log(fit.numbers.steps)) >= lowest),
                      slowest=SLOWEST_POLE * lowest)
    model = coupled_model(numbers, late, fast)
    densities: Sequence[DensityEstimate | None] = ()
    left = np.inf
    for number, levels in enumerate(LEVELS_OF_ROUNDS):
        if number and budget.is_spent(SHARE):
            budget.not_tried.append("hysteresis and creep once more beside the modes")
            break
        progress(f"hysteresis and creep, round {number + 1}", 0.75 + 0.03 * number)
        actuators, densities = estimate_actuators(model, steps, loops, levels, densities)
        if not any(each.hysteresis or each.creep.poles_rad_per_s for each in actuators):
            return None
        tried = _About(replace(model, actuators=actuators), numbers, late, fast, recordings)
        found, found_spectra = tried.fitted()
        before, left = left, sum(np.log(np.sum(np.abs(each) ** 2)) for each in found.left)
        if left > before:
            break
        if number == 0:
            left = np.inf  # its cells are too coarse to be compared
        about, fit, spectra = tried, found, found_spectra
        numbers, model = fit.numbers, about.model_of(fit)
        if number and before - left < WORTHWHILE * len(recordings):
            break
    if is_open and budget.is_spent(SHARE):
        budget.not_tried.append("further creep")
    elif is_open:
        progress("further creep", 0.85)
        fit = _with_more_creep(fit, spectra)
        fit = without_weak_poles(fit, spectra, JUDGED_STEPS)
        numbers, model = fit.numbers, about.model_of(fit)
    progress("hysteresis, creep and modes together", 0.88)
    about = _About(model, numbers, late, fast, recordings)
    fit, spectra = reweighted_fit(*about.fitted(), is_open)
    model = about.model_of(fit)
    offsets_um = [np.mean(found.measured_um - found.simulated_um, axis=0) for found in (
        predict_several_axes(model, each) for each in recordings)]
    model = replace(model, operating_displacement_um=(
        model.operating_displacement_um + np.mean(offsets_um, axis=0)))
    for axis, actuator in zip(model.axes, model.actuators, strict=True):
        shown = "hysteresis" if actuator.hysteresis else "no hysteresis"
        note(f"{axis}: {shown}, {len(actuator.creep.poles_rad_per_s)} pairs of creep")
    return fit, spectra, model


def _lowest_resonance(steps: ComplexArray) -> float:
    """Return the rate of the slowest light mode, over the sample rate; of any where none is."""
    rates = np.log(steps)
    light = (steps.imag > 0.0) & (-rates.real < LIGHT * np.abs(rates))
    return float(np.abs(rates[light] if light.any() else rates).min())


def _driven(fast: Sequence[AxesRecording],
            actuators: Sequence[Actuator]) -> list[AxesRecording]:
    return [with_drive(each, actuators) for each in fast]


class _About:
    """All recordings, as they are fitted beginning with the hysteresis and creep of a model."""

    def __init__(self, model: CoupledModel, numbers: CoupledNumbers, late: np.ndarray,
                 fast: Sequence[AxesRecording], recordings: Sequence[AxesRecording]) -> None:
        self.actuators, self.late, self.fast = model.actuators, late, fast
        period_s, lowest = model.sample_period_s, _lowest_resonance(numbers.steps)
        longest_s = max(each.sample_period_s * len(each.voltage_v) for each in recordings)
        self.numbers = replace(numbers, actuators=_numbers(self.actuators, period_s, (
            SLOWEST_CREEP * period_s / longest_s, FASTEST_CREEP * lowest)))
        model = coupled_model(numbers, late, _driven(fast, self.actuators), self.actuators)
        self.spectra = [_spectrum(model, each).advanced(late) for each in recordings]
        # What a hysteresis passes on of small and of large motion may differ by half.
        driven = [replace(each, drive=Driven(self.numbers.actuators, each, slice(None)).drive)
                  for each in self.spectra]
        gains = linear_numbers(driven, numbers.steps, len(numbers.direct))
        self.numbers = replace(self.numbers, gains=gains.gains, direct=gains.direct)

    def fitted(self) -> tuple[CoupledFit, list[Spectrum]]:
        """Return the fit of all numbers."""
        return _reweighted(refined(self.numbers, self.spectra, 0), self.spectra)

    def model_of(self, fit: CoupledFit) -> CoupledModel:
        """Return the model of a fit."""
        period_s = self.fast[0].sample_period_s
        actuators = tuple(_changed(actuator, axis, fit.numbers.actuators, period_s)
                          for axis, actuator in enumerate(self.actuators))
        return coupled_model(fit.numbers, self.late, _driven(self.fast, actuators), actuators)


def _with_more_creep(fit: CoupledFit, spectra: Sequence[Spectrum]) -> CoupledFit:
    """Return the fit to which creep was added, axis by axis, as long as that gains evidence."""
    axes = [axis for axis in range(fit.left[0].shape[1])
            if any(axis in spectrum.driven for spectrum in spectra)]
    while axes:
        more = [refined(replace(fit.numbers, actuators=fit.numbers.actuators.with_creep(
            axes[0], rate, LEAST_CREEP)), spectra, JUDGED_STEPS)
            for rate in np.geomspace(*fit.numbers.actuators.rates, TRIED_RATES + 2)[1:-1]]
        best = max(more, key=evidence_of)
        if evidence_of(best) > evidence_of(fit) and best.numbers.actuators.gains[-1] > 0.0:
            fit = refined(best.numbers, spectra, FINAL_STEPS)
        else:
            axes.pop(0)
    return fit


def _numbers(actuators: Sequence[Actuator], period_s: float,
             rates_between: tuple[float, float]) -> ActuatorNumbers:
    lowest = [np.zeros(0) if each.hysteresis is None else lowest_changes(each.hysteresis)
              for each in actuators]
    gains = [each.creep_gains for each in actuators]
    rates = np.concatenate([np.array(each.creep.poles_rad_per_s) for each in actuators])
    axes = np.arange(len(actuators))
    return ActuatorNumbers(
        np.repeat(axes, [each.size for each in lowest]),
        np.zeros(sum(each.size for each in lowest)), np.concatenate(lowest),
        np.repeat(axes, [each.size for each in gains]), np.log(rates * period_s),
        np.concatenate(gains), rates_between)


def _changed(actuator: Actuator, axis: int, numbers: ActuatorNumbers, period_s: float) -> Actuator:
    """Return the actuator of an axis with the numbers of a fit."""
    own = (numbers.creep_axes == axis) & (numbers.gains > 0.0)
    rates, of_rate = np.unique(np.round(numbers.logarithms[own], 2), return_inverse=True)
    gains: FloatArray = np.bincount(of_rate, numbers.gains[own], rates.size).astype(float)
    creep, _ = creep_of_partial_fractions(np.exp(rates) / period_s, gains)
    if actuator.hysteresis is None:
        return replace(actuator, creep=creep)
    alone = StageModel(actuator.hysteresis, CreepDynamics(), ElectricVibrationDynamics())
    changed = changed_model(alone, numbers.changes[numbers.piece_axes == axis])
    return Actuator(changed.hysteresis, creep)


def _spectrum(model: CoupledModel, recording: AxesRecording) -> Spectrum:
    """Return the spectrum of a recording behind the hysteresis, ahead of the creep.

    What rings between the rows of a slow recording is taken off.
    """
    circumstances, periods = circumstances_of(model, recording), recording.periods or 1
    columns = recording.voltage_v.reshape(periods, -1, len(model.axes)).mean(axis=0).T
    passed, pieces = [], []
    for actuator, voltage_v, past in zip(model.actuators, np.ascontiguousarray(columns),
                                         circumstances.pasts, strict=True):
        passed_v = actuator.passed_v(voltage_v, bool(recording.periods), past)
        passed.append(np.tile(passed_v, periods))
        if actuator.hysteresis is not None:
            pieces += [np.tile(each, periods) for each in _pieces_v(
                actuator, voltage_v, passed_v, bool(recording.periods), past)]
    rows = rows_apart(model, recording)
    displacement_um = recording.displacement_um
    if circumstances.is_held and rows != 1.0:
        slow = model.at_period(recording.sample_period_s)
        displacement_um = displacement_um - sum(
            sign * simulated_um(each, recording, circumstances)
            for sign, each in ((1.0, slow), (-1.0, slow.at_rest())))
    return spectrum_of(
        replace(recording, voltage_v=np.column_stack(passed), displacement_um=displacement_um),
        rows, circumstances.is_held, pieces)


def _pieces_v(actuator: Actuator, voltage_v: FloatArray, passed_v: FloatArray, periodic: bool,
              past: str) -> Iterator[FloatArray]:
    """Yield what each change of the hysteresis adds to the voltage that it passes on."""
    assert actuator.hysteresis is not None
    for piece in pieces_of(actuator.hysteresis):
        alone = Actuator(piece)
        # The mean slope of the whole is one by definition, however a piece changes it.
        part = alone.slope_um_per_v / actuator.slope_um_per_v
        yield part * (alone.passed_v(voltage_v, periodic, past) - passed_v)
