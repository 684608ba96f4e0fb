# SPDX-License-Identifier: BSD-3-Clause
"""Feedback by answers to blocks, each of which is held for one tick."""

import math

import numpy as np

from piezo_stage_driver.safety.limits import FeedbackLimits


class FeedbackError(ValueError):
    """An answer that is not a voltage, or belongs to no block."""


class FeedbackHold:
    """Feedback voltage (`voltage_v`) of every tick since tracking began in its first tick.

    The block published at the start of tick k is answered during tick k, and the answer acts in
    tick k + 1; the block of the tick after the first requires the first answer. If none came in
    time, the last one is held and counted as missed; answers beyond the limits are counted as
    limited. Blocks come later by a lead, where the hardware is written ahead. Answers may come from
    another thread than the ticks.
    """

    def __init__(self, first_tick: int, lead_ticks: int = 0, limits: FeedbackLimits | None = None):
        self.voltage_v = 0.0
        self.missed = self.missed_in_a_row = 0
        self.limited = self.limited_in_a_row = 0
        self._limits = limits or FeedbackLimits()
        self._first_tick = first_tick + lead_ticks
        self._answers: dict[int, float] = {}

    each_sample = False
    """Whether the feedback changes within a tick."""

    @property
    def cause(self) -> str:
        """Return why the answers must stop the stage; empty if they need not."""
        if self.limited_in_a_row <= self._limits.patience:
            return ""
        return (f"{self.limited_in_a_row} feedback answers in a row were beyond "
                f"{self._limits.maximum_v:g} V, or stepped by more than "
                f"{self._limits.maximum_step_v:g} V")

    def answer(self, tick: int, voltage_v: float, present_tick: int) -> None:
        """Store the answer to the block of ``tick``; one that comes too late has no effect.

        Raises `FeedbackError` if the voltage is not a finite number, or the block is still to come.
        """
        if not math.isfinite(voltage_v):
            raise FeedbackError(f"the feedback for tick {tick} is not a finite number: "
                                "send finite voltages only")
        if tick > present_tick:
            raise FeedbackError(f"the feedback is for tick {tick}, which is still to come: "
                                "answer the tick of the last block")
        if tick + 1 >= present_tick:
            self._answers[tick] = voltage_v

    def awaited(self, tick: int) -> bool:
        """Return whether playing ``tick`` now would miss an answer."""
        return tick - 1 > self._first_tick and tick - 1 not in self._answers

    def begin(self, tick: int) -> bool:
        """Apply the answer for ``tick``; return whether the last one is held instead."""
        if tick - 1 <= self._first_tick:
            return False
        # Read once: an answer that came between two reads would act and yet count as missed.
        answer_v = self._answers.pop(tick - 1, None)
        # One by one, because answers may come from another thread meanwhile.
        for old in [k for k in list(self._answers) if k < tick - 1]:
            self._answers.pop(old, None)
        if answer_v is None:
            self.missed += 1
            self.missed_in_a_row += 1
            return True
        self.missed_in_a_row = 0
        self._take(answer_v)
        return False

    def add(self, planned_v: np.ndarray) -> np.ndarray:
        """Return planned voltages with the feedback that acts, shape (n,), in V."""
        return planned_v + self.voltage_v

    def take(self, tick: int, voltage_v: np.ndarray, displacement_um: np.ndarray) -> None:
        """Ignore the measurement, which is answered by another node."""

    def _take(self, answer_v: float) -> None:
        self.voltage_v, limited = self._limits.apply(answer_v, self.voltage_v)
        self.limited += limited
        self.limited_in_a_row = self.limited_in_a_row + 1 if limited else 0
