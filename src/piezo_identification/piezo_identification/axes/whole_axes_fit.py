# SPDX-License-Identifier: BSD-3-Clause
"""The last fit of a model of several axes: all parameters to all recordings together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from piezo_common.arrays import FloatArray
from piezo_common.budget import while_time_lasts
from piezo_identification.axes.axes_errors import AxesErrors
from piezo_identification.axes.coupled_numbers import CoupledNumbers
from piezo_identification.axes.free_axes import FreeAxes
from piezo_identification.axes.predict_axes import SAME_PERIOD, predict_several_axes
from piezo_identification.fitting.joint_fit import SETTINGS
from piezo_identification.fitting.levenberg_marquardt import descend
from piezo_models.axes.coupled import CoupledModel
from piezo_recorder.reading.axes import AxesRecording

STEPS = 10
"""Largest number of steps of the fit, which takes three on the simulated stages of two axes."""

LAST_FIT = "the last fit of all parameters to all recordings"
"""What is cut short once the time is over."""


@dataclass(frozen=True, eq=False)
class FittedStage:
    """A model of several axes with the numbers of its modes."""

    numbers: CoupledNumbers
    model: CoupledModel

    known: list[FloatArray]
    """Covariance of the numbers of each motion, as `coupled_fit.covariances` returns it."""


def fit_to_all(stage: FittedStage, recordings: Sequence[AxesRecording]) -> FittedStage:
    """Fit hysteresis, creep, poles, residues and direct part of a stage to all its recordings.

    The errors are never larger than before. Softening is kept as it is. The initial model has
    actuators. If the time is over, the covariances are those of before.
    """
    free = FreeAxes(stage.model, stage.numbers)
    errors, changes, known = AxesErrors(free, recordings), np.zeros(free.low.size), stage.known
    with while_time_lasts(LAST_FIT):
        changes = descend(errors, changes, STEPS, SETTINGS.worthwhile).vector
        found = free.covariances_of_numbers(errors.covariance(changes))
        # The fit does not change the softening, whose numbers come last.
        known = [block_diag(each, before[len(each):, len(each):])
                 for each, before in zip(found, known, strict=True)]
    return FittedStage(free.numbers_at(changes), _centred(free.model_at(changes), recordings),
                       known)


def _centred(model: CoupledModel, recordings: Sequence[AxesRecording]) -> CoupledModel:
    """Return the model whose displacement agrees on average with the fastest that move an axis.

    In slow recordings it depends on earlier creep, and at rest on how the voltage was reached.
    """
    offset_um = np.array([np.mean(each.measured_um - each.simulated_um, axis=0) for each in (
        predict_several_axes(model, recording) for recording in recordings)])
    moves = np.array([np.ptp(each.voltage_v, axis=0) > 0.0 for each in recordings])
    period_s = np.array([each.sample_period_s for each in recordings])[:, None]
    shortest_s = np.min(np.where(moves, period_s, np.inf), axis=0)
    counts = moves & (period_s <= (1.0 + SAME_PERIOD) * shortest_s)
    return replace(model, operating_displacement_um=(
        model.operating_displacement_um + np.average(offset_um, axis=0, weights=counts)))
