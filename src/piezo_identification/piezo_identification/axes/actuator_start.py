# SPDX-License-Identifier: BSD-3-Clause
"""Start of hysteresis and creep of each axis, with the modes behind them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezo_common.budget import has_time_for
from piezo_identification.axes.actuator_drive import with_drive
from piezo_identification.axes.actuator_estimate import estimate_actuators
from piezo_identification.axes.amplifier_lags import with_amplifier_lags
from piezo_identification.axes.coupled_fit import CoupledFit
from piezo_identification.axes.modal_model import coupled_model
from piezo_identification.axes.modes_fit import Note, Progress, fitted_modes, without_slow_poles
from piezo_identification.axes.predict_axes import predict_several_axes
from piezo_identification.axes.spectra import Spectrum, spectra_of_levels
from piezo_models.axes.coupled import CoupledModel
from piezo_recorder.reading.axes import AxesRecording

LEVELS = (12, 50)
"""Levels of the hysteresis in the first and the second estimate. In the first, with modes that were
fitted without hysteresis, more would follow errors of the modes."""

SECOND_ESTIMATE, FIRST = "second estimate of hysteresis and creep, with the modes", 0.6
"""What is omitted, and from which share of the time: it takes up to a third of it."""

LAGS = "lags of the amplifiers"
"""What is omitted from the same share of the time."""


@dataclass(frozen=True, eq=False)
class StartedStage:
    """Modes as fitted to spectra, and the model with hysteresis and creep in front of them."""

    fit: CoupledFit

    spectra: list[Spectrum]
    """That were fitted."""
    model: CoupledModel


def start_of_actuators(
    fit: CoupledFit, spectra: Sequence[Spectrum], late: np.ndarray,
    by_experiment: Mapping[str, Sequence[AxesRecording]],
    fast: Sequence[AxesRecording], pairs: int | None, note: Note, progress: Progress,
) -> StartedStage | None:
    """Estimate hysteresis and creep of each axis with the modes given, and then the modes, twice.

    The fit is that of the modes alone to the spectra, with the latency of each sensor, (n,). The
    recordings are given by their experiment, and those of the shortest sample period once more. The
    one of the two estimates with less residual is returned; None where no axis shows hysteresis or
    creep. For the other parameters see `identify_several_axes`.
    """
    recordings = [each for listed in by_experiment.values() for each in listed]
    slow = [*by_experiment["creep"], *by_experiment["hysteresis"]]
    loops = by_experiment["hysteresis"] or slow
    steps = by_experiment["creep"] or slow
    model = coupled_model(without_slow_poles(fit.numbers, spectra), late, fast)
    found: list[StartedStage] = []
    for number, levels in enumerate(LEVELS):
        if number and not has_time_for(SECOND_ESTIMATE, FIRST):
            break
        progress(f"hysteresis and creep, estimate {number + 1}", 0.6 + 0.1 * number)
        actuators = estimate_actuators(model, steps, loops, levels)
        if not any(each.hysteresis or each.creep.poles_rad_per_s for each in actuators):
            return None
        found.append(_behind(replace(model, actuators=actuators), fast, pairs))
        model = found[-1].model
    best = min(found, key=lambda each: _residual(each.model, recordings))
    if has_time_for(LAGS, FIRST):
        progress(LAGS, 0.75)
        lagging = with_amplifier_lags(best.model, best.fit.numbers.steps, fast)
        if any(each.lag_s for each in lagging.actuators):
            # Its gains may fit the slow recordings worse until all parameters are fitted together.
            best = _behind(lagging, fast, pairs)
    for axis, actuator in zip(model.axes, best.model.actuators, strict=True):
        shown = "hysteresis" if actuator.hysteresis else "no hysteresis"
        lag = f", an amplifier lag of {actuator.lag_s:.3g} s" if actuator.lag_s else ""
        note(f"{axis}: {shown}, {len(actuator.creep.poles_rad_per_s)} pairs of creep{lag}")
    return best


def _behind(model: CoupledModel, fast: Sequence[AxesRecording],
            pairs: int | None) -> StartedStage:
    """Fit the modes behind hysteresis and creep."""
    driven = [with_drive(model, each) for each in fast]
    fit, spectra, late = fitted_modes(
        spectra_of_levels(driven), pairs, _silent, _silent, behind_actuators=True)
    return StartedStage(fit, spectra, coupled_model(fit.numbers, late, driven, model.actuators))


def _silent(*_: object) -> None:
    """Ignore notes and progress."""


def _residual(model: CoupledModel, recordings: Sequence[AxesRecording]) -> float:
    """Return the sum of the logarithms of the mean square residuals of recordings."""
    predictions = (predict_several_axes(model, each) for each in recordings)
    return float(sum(np.log(np.sum(np.var(each.measured_um - each.simulated_um, axis=0)))
                     for each in predictions))
