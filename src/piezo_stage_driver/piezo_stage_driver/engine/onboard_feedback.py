# SPDX-License-Identifier: BSD-3-Clause
"""Feedback on board: an uploaded law instead of answers to blocks."""

from typing import Any

import numpy as np

from piezo_models.feedback_law.feedback_law import FeedbackLaw, FeedbackLawError
from piezo_models.feedback_law.law_check import check_law
from piezo_models.feedback_law.running_axes_law import RunningAxesLaw
from piezo_models.feedback_law.running_law import RunningLaw
from piezo_stage_driver.engine.feedback_hold import FeedbackError
from piezo_stage_driver.safety.law_guard import AxesLawGuard, LawGuard
from piezo_stage_driver.safety.limits import FeedbackLimits


class CheckedLaw:
    """A law that was checked for this stage.

    Raises `FeedbackLawError` if the law is invalid, see `check_law`, or may exceed the limits of
    the stage.
    """

    def __init__(self, law: FeedbackLaw, samples_per_tick: int, lead_ticks: int,
                 rest_voltage_v: Any, limits: FeedbackLimits) -> None:
        if law.max_feedback_v > limits.maximum_v:
            raise FeedbackLawError(f"max_feedback_v of the law is {law.max_feedback_v:g} V, more "
                                   f"than this stage takes, {limits.maximum_v:g} V: lower it")
        check_law(law, samples_per_tick, lead_ticks)
        self.law = law
        self._arguments = law, samples_per_tick, rest_voltage_v, limits.maximum_step_v
        # Compiles the tables of the hysteresis here rather than between two ticks.
        self.running()

    def running(self) -> RunningLaw | RunningAxesLaw:
        """Return the law in its initial state."""
        law, samples_per_tick, rest_voltage_v, largest_step_v = self._arguments
        if law.axes:
            return RunningAxesLaw(law, samples_per_tick, largest_step_v)
        return RunningLaw(law, samples_per_tick, rest_voltage_v, largest_step_v)


class OnboardFeedback:
    """Feedback of every tick since tracking began, used instead of a `FeedbackHold`.

    No answers are needed, so none are missed. `limited` counts the ticks in which the law exceeded
    the limits; `each_sample` is True if the feedback changes within a tick. The measurements come
    later by the lead, where the hardware is written ahead.
    """

    missed = missed_in_a_row = 0

    def __init__(self, checked: CheckedLaw, first_tick: int, lead_ticks: int,
                 limits: FeedbackLimits) -> None:
        self._law, self.each_sample = checked.running(), not checked.law.sample.empty
        self._first_tick, self._lead_ticks, self._limits = first_tick, lead_ticks, limits
        self._guard: LawGuard | AxesLawGuard = (
            AxesLawGuard if checked.law.axes else LawGuard)(checked.law)
        self._cause = ""
        self.limited = self.limited_in_a_row = 0

    @property
    def voltage_v(self) -> Any:
        """Return the voltage that acts (V)."""
        return self._law.voltage_v

    @property
    def cause(self) -> str:
        """Return why the law must stop the stage; empty if it need not."""
        if self.limited_in_a_row > self._limits.patience:
            return (f"the feedback law stepped by more than {self._limits.maximum_step_v:g} V in "
                    f"{self.limited_in_a_row} ticks in a row")
        return self._cause

    def replace(self, checked: CheckedLaw) -> None:
        """Switch to another law between two ticks.

        Raises `FeedbackLawError` if the law cannot take over, see `RunningLaw.take_over`, or is of
        several axes; the present law then continues.
        """
        law, present, guard = checked.running(), self._law, self._guard
        if not (isinstance(law, RunningLaw) and isinstance(present, RunningLaw)
                and isinstance(guard, LawGuard)):
            raise FeedbackLawError("a law of several axes is not replaced within a run: load it "
                                   "between two runs")
        law.take_over(present)
        self._guard = guard.of_next(checked.law)
        self._law, self.each_sample = law, not law.law.sample.empty

    def answer(self, tick: int, voltage_v: float, present_tick: int) -> None:
        """Raise `FeedbackError`, as a law takes no answers."""
        raise FeedbackError("the stage evaluates an uploaded law and takes no answers: "
                            "end the publisher of feedback")

    def awaited(self, tick: int) -> bool:
        """Return False: no answers are awaited."""
        return False

    def begin(self, tick: int) -> bool:
        """Begin a tick; return False: nothing is held."""
        self.limited += self._law.stepped
        self.limited_in_a_row = self.limited_in_a_row + 1 if self._law.stepped else 0
        return False

    def add(self, planned_v: np.ndarray) -> np.ndarray:
        """Return planned voltages with the feedback that acts, of the same shape, in V."""
        return planned_v + self._law.begin(planned_v)

    def limit(self, clipped_v: np.ndarray) -> None:
        """Take the correction by the limits to the last result of `add`, of its shape, in V."""
        self._law.correct(clipped_v.mean(axis=0))

    def take_sample(self, displacement_um: np.ndarray) -> None:
        """Take the sample that was measured while the last one was played, shape (1,)."""
        self._law.take(displacement_um)

    def take(self, tick: int, voltage_v: np.ndarray, displacement_um: np.ndarray) -> None:
        """Take the samples measured while ``tick`` was played, shape (n,) or (n, axes)."""
        if tick < self._first_tick + self._lead_ticks:
            return
        if not self.each_sample:
            self._law.take(displacement_um)
        error_um: Any = self._law.error_um
        if self._law.begun:
            self._cause = self._cause or self._guard.examine(error_um)
        else:
            self._guard.watch(voltage_v, displacement_um, error_um)
