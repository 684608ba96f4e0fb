# SPDX-License-Identifier: BSD-3-Clause
"""The free parameters of a model of several axes in a joint fit, as changes in prior widths.

Each actuator has those of the creep and the hysteresis of one axis, see `free_parameters`, and then
those of a Bouc-Wen hysteresis and the lag of its amplifier, if it has them. The poles follow, and
then the gains of each motion.
"""

from dataclasses import replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.axes.coupled_numbers import CoupledNumbers
from piezo_identification.axes.modal_model import modal_model
from piezo_identification.fitting.free_parameters import (
    WIDTHS,
    changed_model,
    free_count,
    lowest_changes,
    physical_count,
)
from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled import CoupledModel
from piezo_models.cascade import StageModel
from piezo_models.effects import fitted_values, with_fitted_values
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import ElectricVibrationDynamics


class FreeAxes:
    """The parameters of a model, with actuators, that a joint fit changes.

    The changes of each actuator, of the poles, and of the gains of all motions have the places
    `of_actuators`, `of_poles` and `of_gains`. `low` are the lowest changes, (n,), and
    `is_hysteresis`, (n,), marks those in which the drive is linear: of a Preisach hysteresis.
    """

    def __init__(self, model: CoupledModel, numbers: CoupledNumbers) -> None:
        self.model, self._numbers = model, numbers
        self._stages = [_stage_of(each) for each in model.actuators]
        each_of = list(zip(model.actuators, self._stages, strict=True))
        lowest = [_lowest(*each) for each in each_of]
        ends = np.cumsum([0, *(each.size for each in lowest), len(numbers.gains),
                          numbers.own().size])
        *self.of_actuators, self.of_poles, self.of_gains = (
            slice(int(begin), int(end)) for begin, end in zip(ends[:-1], ends[1:], strict=True))
        self.low = np.full(ends[-1], -np.inf)
        self.low[: self.of_poles.start] = np.concatenate(lowest)
        self.is_hysteresis = np.zeros(ends[-1], dtype=bool)
        for places, (actuator, stage) in zip(self.of_actuators, each_of, strict=True):
            first = places.start + physical_count(stage)
            self.is_hysteresis[first : first + _hysteresis_count(actuator, stage)] = True
        self.pole_widths = WIDTHS.logarithm * np.abs(numbers.logarithms)
        largest = [*np.abs(numbers.gains).max(axis=(1, 2)), *np.full(
            len(numbers.direct), np.abs(numbers.direct).max(initial=0.0))]
        self.gain_widths = WIDTHS.logarithm * np.repeat(largest, len(model.axes))
        """Alike for all motions."""

    def numbers_at(self, changes: FloatArray) -> CoupledNumbers:
        """Return the numbers of the modes after changes of all parameters."""
        shared, own = self._numbers.shared(), self._numbers.own()
        shared[: self.pole_widths.size] += self.pole_widths * changes[self.of_poles]
        return self._numbers.with_numbers(
            shared, own + self.gain_widths * changes[self.of_gains].reshape(own.shape))

    def actuator_at(self, axis: int, changes: FloatArray) -> Actuator:
        """Return the actuator of an axis after changes of all parameters."""
        stage, own = self._stages[axis], changes[self.of_actuators[axis]]
        actuator = self.model.actuators[axis]
        count = physical_count(stage) + _hysteresis_count(actuator, stage)
        of_stage, of_bouc_wen, of_lag = np.split(own, [count, own.size - (actuator.lag_s > 0.0)])
        changed = changed_model(stage, np.pad(of_stage, (0, free_count(stage) - count)))
        return Actuator(actuator.hysteresis and changed.hysteresis, changed.creep,
                        actuator.lag_s * float(np.exp(WIDTHS.logarithm * of_lag.sum())),
                        actuator.bouc_wen and with_fitted_values(
                            actuator.bouc_wen, fitted_values(actuator.bouc_wen)[0]
                            + WIDTHS.logarithm * of_bouc_wen))

    def is_possible(self, changes: FloatArray) -> bool:
        """Return whether a stage can have the hysteresis of each actuator after changes."""
        loops = (self.actuator_at(axis, changes).bouc_wen
                 for axis in range(len(self.of_actuators)))
        return not any(each.goes_back for each in loops if each)

    def model_at(self, changes: FloatArray) -> CoupledModel:
        """Return the model after changes of all parameters."""
        modes = self.modes_of(self.numbers_at(changes))
        return replace(
            self.model, poles_rad_per_s=modes.poles_rad_per_s,
            residues_um_per_v=modes.residues_um_per_v, direct_um_per_v=modes.direct_um_per_v,
            actuators=tuple(self.actuator_at(axis, changes)
                            for axis in range(len(self.of_actuators))))

    def covariances_of_numbers(self, covariance: FloatArray) -> list[FloatArray]:
        """Return for each motion the covariance of its own numbers with the poles behind them.

        The covariance of the changes, (n, n), is given.
        """
        widths, count = np.append(self.gain_widths, self.pole_widths), self.gain_widths.size
        poles = np.arange(self.of_poles.start, self.of_poles.stop)
        firsts = range(self.of_gains.start, self.of_gains.stop, count)
        places = [np.append(np.arange(first, first + count), poles) for first in firsts]
        return [covariance[np.ix_(each, each)] * np.outer(widths, widths) for each in places]

    def modes_of(self, numbers: CoupledNumbers) -> CoupledModel:
        """Return the model of some numbers about zero, without actuators and softening."""
        return modal_model(numbers, self.model.latency_samples, self.model.axes,
                           self.model.sample_period_s)

    def mode_at(self, place: int, changes: FloatArray) -> CoupledModel:
        """Return the mode of a pole's number alone."""
        numbers = self.numbers_at(changes)
        return self.modes_of(replace(numbers.with_poles(_only(numbers, place)),
                                     direct=0.0 * numbers.direct))

    def gain_at(self, place: int, changes: FloatArray) -> CoupledModel:
        """Return what one width of a gain moves, alike in all motions."""
        numbers = self.numbers_at(changes)
        column, axis = divmod(place, len(self.model.axes))
        is_mode = column < len(numbers.gains)
        gains, direct = 0.0 * numbers.gains, 0.0 * numbers.direct
        (gains if is_mode else direct)[column - (0 if is_mode else len(gains)), :, axis] = (
            self.gain_widths[place])
        kept = _only(numbers, column) if is_mode else np.zeros(numbers.steps.size, dtype=bool)
        return self.modes_of(replace(numbers, gains=gains, direct=direct).with_poles(kept))


def _only(numbers: CoupledNumbers, column: int) -> np.ndarray:
    """Return which pole a column of the modes belongs to, (poles,)."""
    pairs = int(np.count_nonzero(numbers.steps.imag > 0.0))
    pole = column // 2 if column < 2 * pairs else column - pairs
    return np.asarray(np.arange(numbers.steps.size) == pole)


def _stage_of(actuator: Actuator) -> StageModel:
    """Return the model of one axis with the hysteresis and creep of an actuator."""
    return StageModel(actuator.hysteresis or PreisachModel.line(0.0, 1.0, 1.0), actuator.creep,
                      ElectricVibrationDynamics())


def _lowest(actuator: Actuator, stage: StageModel) -> FloatArray:
    parts = [np.full(physical_count(stage), -np.inf),
             lowest_changes(stage.hysteresis)[: _hysteresis_count(actuator, stage)]]
    if actuator.bouc_wen is not None:
        values, low, _ = fitted_values(actuator.bouc_wen)
        parts.append((low - values) / WIDTHS.logarithm)
    return np.concatenate([*parts, [-np.inf] * (actuator.lag_s > 0.0)])


def _hysteresis_count(actuator: Actuator, stage: StageModel) -> int:
    return 0 if actuator.hysteresis is None else free_count(stage) - physical_count(stage)
