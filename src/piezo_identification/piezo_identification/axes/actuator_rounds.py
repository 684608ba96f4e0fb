# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis and creep of each axis, and the modes behind them, estimated in turn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_common.budget import has_time_for
from piezo_identification.axes.actuator_estimate import estimate_actuators
from piezo_identification.axes.coupled_fit import CoupledFit
from piezo_identification.axes.coupled_numbers import CoupledNumbers
from piezo_identification.axes.modes_fit import (
    Note,
    Progress,
    fitted_modes,
    without_slow_poles,
)
from piezo_identification.axes.predict_axes import (
    circumstances_of,
    predict_several_axes,
    simulated_um,
)
from piezo_identification.axes.spectra import Spectrum, played_lines, spectra_of_levels
from piezo_identification.estimators.hysteresis.density_estimate import DensityEstimate
from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled import CoupledModel
from piezo_recorder.reading.axes import AxesRecording

LEVELS_OF_ROUNDS = (12, 50, 50, 50)
"""Levels of the hysteresis in each round. In the first more would follow errors of the modes."""

WORTHWHILE = 0.5
"""Logarithm by which the mean square residual of each recording falls, on average, in a round
that another one follows."""

FURTHER_ROUND, ROUNDS = "second estimate of hysteresis and creep, with the modes", 0.6
"""What is omitted, and from which share of the time: one round takes up to a third of it."""


@dataclass(frozen=True, eq=False)
class FittedStage:
    """Modes, and the hysteresis and creep of each axis in front of them."""

    fit: CoupledFit

    spectra: list[Spectrum]
    """That were fitted."""
    model: CoupledModel

    scale_off: FloatArray
    """Part by which slow recordings move more with each axis than fast ones, (n,)."""


def with_drive(model: CoupledModel, recording: AxesRecording) -> AxesRecording:
    """Return a recording with the drive of the modes in place of its voltage.

    The drive of a periodic voltage is reduced to the lines of the voltage: between them hysteresis
    adds too little to determine a response.
    """
    periods = recording.periods or 1
    voltage_v = recording.voltage_v.reshape(periods, -1, len(model.axes)).mean(axis=0)
    drive_v = model.drive_v(
        voltage_v, bool(recording.periods), circumstances_of(model, recording).pasts)
    resting = np.ptp(voltage_v, axis=0) == 0.0
    drive_v[:, resting] = drive_v[0, resting]  # without the rounding of the creep
    if recording.periods:
        lines = np.fft.rfft(drive_v, axis=0)
        lines[~played_lines(np.fft.rfft(voltage_v, axis=0))] = 0.0
        drive_v = drive_v.mean(axis=0) + np.fft.irfft(lines, len(drive_v), axis=0)
    return replace(recording, voltage_v=np.tile(drive_v, (periods, 1)))


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
    voltage_v, displacement_um = (
        np.average([np.mean(signal, axis=0) for signal in signals], axis=0, weights=samples)
        for signals in zip(*((each.voltage_v, each.displacement_um) for each in driven),
                           strict=True))
    return replace(modal_model(numbers, late, first.axes, first.sample_period_s),
                   operating_voltage_v=voltage_v, operating_displacement_um=displacement_um,
                   actuators=actuators)


def modal_model(numbers: CoupledNumbers, late: np.ndarray, axes: tuple[str, ...],
                sample_period_s: float) -> CoupledModel:
    """Return the model of some numbers about zero, without softening."""
    poles = (np.log(numbers.steps) / sample_period_s).astype(complex)
    return CoupledModel(
        axes, sample_period_s, poles, residues_of(numbers, numbers.gains), numbers.direct, late,
        np.zeros(len(axes)), np.zeros(len(axes)))


def residues_of(numbers: CoupledNumbers, gains: FloatArray) -> ComplexArray:
    """Return the residues that gains of `mode_basis` stand for, one of each pair first."""
    pairs = 2 * int(np.count_nonzero(numbers.steps.imag > 0.0))
    return np.concatenate([gains[0:pairs:2] + 1j * gains[1:pairs:2], gains[pairs:].astype(complex)])


def in_rounds(
    fit: CoupledFit, late: np.ndarray, by_experiment: Mapping[str, Sequence[AxesRecording]],
    fast: Sequence[AxesRecording], pairs: int | None, note: Note, progress: Progress,
) -> FittedStage | None:
    """Estimate hysteresis and creep of each axis with the modes given, and then the modes.

    Each round begins with the modes as they are known by then, at first without hysteresis. The
    best one counts.

    Parameters
    ----------
    fit : CoupledFit
        Fit of the modes alone.
    late : (n,) array of int
        Latency of each sensor.
    by_experiment : mapping of str to sequence of AxesRecording
        "dynamics", "creep" and "hysteresis".
    fast : sequence of AxesRecording
        Those of the shortest sample period.
    pairs : int, optional
        Pairs of poles; by evidence by default.
    note : callable
        Called with what was found of each axis.
    progress : callable
        Called with (stage, fraction) when a stage begins.

    Returns
    -------
    FittedStage or None
        None where no axis shows hysteresis or creep.
    """
    recordings = [each for listed in by_experiment.values() for each in listed]
    slow = [*by_experiment["creep"], *by_experiment["hysteresis"]]
    loops = by_experiment["hysteresis"] or slow
    steps = by_experiment["creep"] or slow
    model = coupled_model(without_slow_poles(fit.numbers), late, fast)
    best, least = None, np.inf
    densities: Sequence[DensityEstimate | None] = ()
    for number, levels in enumerate(LEVELS_OF_ROUNDS):
        if number and not has_time_for(FURTHER_ROUND, ROUNDS):
            break
        progress(f"hysteresis and creep, round {number + 1}", 0.6 + 0.07 * number)
        actuators, densities = estimate_actuators(model, steps, loops, levels, densities)
        if not any(each.hysteresis or each.creep.poles_rad_per_s for each in actuators):
            return None
        found = _behind(replace(model, actuators=actuators), fast, slow, pairs)
        residual = _residual(found.model, recordings)
        gained, model = least - residual, found.model
        if gained > 0.0:
            best, least = found, residual
        if gained < WORTHWHILE * len(recordings):
            break
    assert best is not None
    offsets_um = [np.mean(found.measured_um - found.simulated_um, axis=0) for found in (
        predict_several_axes(best.model, each) for each in recordings)]
    model = replace(best.model, operating_displacement_um=(
        best.model.operating_displacement_um + np.mean(offsets_um, axis=0)))
    for axis, actuator in zip(model.axes, model.actuators, strict=True):
        shown = "hysteresis" if actuator.hysteresis else "no hysteresis"
        note(f"{axis}: {shown}, {len(actuator.creep.poles_rad_per_s)} pairs of creep")
    return replace(best, model=model)


def _behind(model: CoupledModel, fast: Sequence[AxesRecording], slow: Sequence[AxesRecording],
            pairs: int | None) -> FittedStage:
    """Fit the modes behind hysteresis and creep; the large motion determines each axis' gain."""
    actuators, driven = model.actuators, [with_drive(model, each) for each in fast]
    fit, spectra, late = fitted_modes(
        spectra_of_levels(driven), pairs, _silent, _silent, behind_actuators=True)
    scales = _scales(coupled_model(fit.numbers, late, driven, actuators), slow)
    numbers = replace(fit.numbers, gains=fit.numbers.gains * scales,
                      direct=fit.numbers.direct * scales)
    return FittedStage(
        replace(fit, numbers=numbers),
        [replace(each, drive=each.drive / scales) for each in spectra],
        coupled_model(numbers, late, driven, actuators), np.abs(scales - 1.0))


def _scales(model: CoupledModel, slow: Sequence[AxesRecording]) -> FloatArray:
    """Return by which factor recordings move more with each axis than a model says, (n,)."""
    alone = [replace(model, residues_um_per_v=model.residues_um_per_v * own,
                     direct_um_per_v=model.direct_um_per_v * own)
             for own in np.eye(len(model.axes))]
    rows, targets = [], []
    for each in slow:
        prediction, circumstances = predict_several_axes(model, each), circumstances_of(model, each)
        residual_um = prediction.measured_um - prediction.simulated_um
        moved_um = np.stack([simulated_um(one, each, circumstances) for one in alone], axis=-1)
        rows.append(((moved_um - moved_um.mean(axis=0)) / np.std(residual_um)).reshape(
            residual_um.size, -1))
        targets.append((residual_um - residual_um.mean(axis=0)).ravel() / np.std(residual_um))
    more: FloatArray = np.linalg.lstsq(
        np.concatenate(rows), np.concatenate(targets), rcond=None)[0]
    return 1.0 + more


def _silent(*_: object) -> None:
    """Ignore notes and progress."""


def _residual(model: CoupledModel, recordings: Sequence[AxesRecording]) -> float:
    """Return the sum of the logarithms of the mean square residuals of recordings."""
    predictions = (predict_several_axes(model, each) for each in recordings)
    return float(sum(np.log(np.sum(np.var(each.measured_um - each.simulated_um, axis=0)))
                     for each in predictions))
