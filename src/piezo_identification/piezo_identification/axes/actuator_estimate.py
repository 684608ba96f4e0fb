# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis and creep of each axis from slow recordings, by the estimators of one axis."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.axes.actuator_drive import with_actuator
from piezo_identification.axes.predict_axes import (
    circumstances_of,
    predict_several_axes,
    rows_apart,
)
from piezo_identification.estimators.creep.slow_creep import estimate_slow_creep
from piezo_identification.estimators.hysteresis.density_estimate import DensityEstimate
from piezo_identification.estimators.hysteresis.density_fit import estimate_density
from piezo_identification.fitting.structure_search import (
    SETTINGS,
    fitted_with_bouc_wen,
    is_at_noise,
    is_better,
)
from piezo_identification.fitting.whole_model import WholeModel
from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled import CoupledModel
from piezo_models.axes.identified_axes import LIGHT
from piezo_models.cascade import StageModel
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.axes import AxesRecording
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

ROUGH_LEVELS, ROUGH_SMOOTHING = 8, 1e-7
"""Levels and smoothing of a hysteresis that only gives the transmitted part of a step."""


def estimate_actuators(model: CoupledModel, creep: Sequence[AxesRecording],
                       hysteresis: Sequence[AxesRecording], levels: int) -> tuple[Actuator, ...]:
    """Estimate hysteresis and creep of each axis, with all other parts of a model given.

    The model has actuators, or modes that were fitted without them. The hysteresis has two cells
    between levels of the voltage, of which there are at most `levels`. The actuators have no
    hysteresis where a line is as good or an axis does not move.
    """
    return tuple(_estimated(model, axis, _moving(axis, creep), _moving(axis, hysteresis), levels)
                 for axis in range(len(model.axes)))


def _moving(axis: int, recordings: Sequence[AxesRecording]) -> list[AxesRecording]:
    return [each for each in recordings if np.ptp(each.voltage_v[:, axis]) > 0.0]


def _estimated(model: CoupledModel, axis: int, steps: Sequence[AxesRecording],
               loops: Sequence[AxesRecording], levels: int) -> Actuator:
    if not loops or not steps:
        return Actuator()
    ringing = None
    if not model.actuators:
        ringing = _ringing(model)
        # What rings after a step is as large as what the hysteresis passes on of it.
        model = with_actuator(model, axis, Actuator())
        rough = _density(model, axis, loops, ROUGH_LEVELS, smoothing=ROUGH_SMOOTHING)
        model = with_actuator(model, axis, Actuator(rough.model()))
    creep = _creep([_alone(model, axis, each) for each in steps], ringing)
    model = with_actuator(model, axis, replace(model.actuators[axis], creep=creep))
    density = _density(model, axis, loops, levels)
    alone = [_alone(model, axis, each) for each in dict.fromkeys((*steps, *loops))]
    start = StageModel(density.model(), creep, ElectricVibrationDynamics())
    return fitted_alone(start, alone, density.is_line)


def fitted_alone(start: StageModel, recordings: Sequence[Recording], is_line: bool) -> Actuator:
    """Return hysteresis and creep fitted together to recordings of one axis without its modes.

    Loops that drift are explained by a Bouc-Wen hysteresis if that is better. If a recording is too
    short for a joint fit, the start is returned. With `is_line`, the recordings show no loops.
    """
    try:
        problem = WholeModel(start, recordings, [0.0] * len(recordings))
    except ValueError:  # a recording is too short
        return Actuator(None if is_line else start.hysteresis, start.creep)
    best = problem.fit(start, None, SETTINGS.steps)
    if is_line:
        return Actuator(None, best.model.creep)
    if not is_at_noise(problem, best):
        drifting, fit, _ = fitted_with_bouc_wen(problem, best, is_plain=True)
        best = best if drifting.why_impossible(fit) or not is_better(fit, best) else fit
    loops = next((each for each in best.model.effects if isinstance(each, BoucWenHysteresis)), None)
    return Actuator(best.model.hysteresis, best.model.creep, bouc_wen=loops)


def _ringing(model: CoupledModel) -> ElectricVibrationDynamics:
    """Return the light modes as those of one axis."""
    poles = model.poles_rad_per_s
    light = poles[(poles.imag > 0.0) & (-poles.real < LIGHT * np.abs(poles))]
    return ElectricVibrationDynamics(
        0.0, tuple(np.abs(light)), tuple(-light.real / np.abs(light)))


def _creep(steps: Sequence[Recording],
           ringing: ElectricVibrationDynamics | None) -> CreepDynamics:
    """Return the creep that steps show, ringing after each of them being left out where given."""
    try:
        found: CreepDynamics = estimate_slow_creep(steps, ringing).model
    except ValueError:  # too fast or too short to show any
        return CreepDynamics()
    return found


def _density(model: CoupledModel, axis: int, loops: Sequence[AxesRecording], levels: int,
             smoothing: float | None = None) -> DensityEstimate:
    return estimate_density(
        [_alone(model, axis, each) for each in loops], model.actuators[axis].creep,
        ElectricVibrationDynamics(), most_levels=levels, smoothing_weight=smoothing)


def _alone(model: CoupledModel, axis: int, recording: AxesRecording) -> Recording:
    """Return the recording of one axis, without what its modes and other axes do.

    The residual answers the voltage of the same row, as means over the row that is held do.
    """
    bare = replace(model, actuators=tuple(
        replace(each, creep=CreepDynamics()) for each in model.actuators))
    prediction = predict_several_axes(bare, recording)
    passed_v = bare.drive_v(recording.voltage_v, pasts=circumstances_of(bare, recording).pasts)
    passed_v = passed_v - passed_v.mean(axis=0)
    gain = model.response(0.0)[0, axis, axis].real
    residual_um = (prediction.measured_um - prediction.simulated_um)[:, axis]
    at_once_um: FloatArray = residual_um + gain * passed_v[:, axis]
    of_axes = np.linalg.lstsq(passed_v, at_once_um - at_once_um.mean(), rcond=None)[0]
    of_axes[axis] = 0.0
    at = np.arange(len(at_once_um))
    return Recording(
        recording.name, 1.0 / model.sample_period_s, round(rows_apart(model, recording)) * at,
        np.full(at.size, recording.sample_period_s), recording.voltage_v[:, axis],
        at_once_um - passed_v @ of_axes, np.full(at.size, Flag.PLAYING))
