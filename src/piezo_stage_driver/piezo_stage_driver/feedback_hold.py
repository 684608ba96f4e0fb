# SPDX-License-Identifier: BSD-3-Clause
"""The slow branch: answers to blocks, each held for one tick."""

import math


class FeedbackError(ValueError):
    """An answer that is not a voltage, or answers nothing."""


class FeedbackHold:
    """Feedback voltage of every tick since tracking began.

    The block published at the start of tick k is answered during tick k; the answer
    acts in tick k + 1. Where none came in time the last one is held and counted.

    Parameters
    ----------
    first_tick : int
        The tick in which tracking began; the block of the next one is the first
        that asks for an answer.
    lead_ticks : int
        How much later the blocks come because the hardware is written ahead.
    """

    def __init__(self, first_tick, lead_ticks=0):
        self.voltage_v = 0.0
        self.missed = 0
        self.missed_in_a_row = 0
        self._first_tick = first_tick + lead_ticks
        self._answers = {}

    def answer(self, tick, voltage_v, present_tick):
        """Keep the answer to the block of ``tick``; one that comes too late has no effect.

        Raises
        ------
        FeedbackError
            If the voltage is not a finite number, or the block is still to come.
        """
        if not math.isfinite(voltage_v):
            raise FeedbackError(f"the feedback for tick {tick} is not a finite number")
        if tick > present_tick:
            raise FeedbackError(f"the feedback is for tick {tick}, which is still to come: "
                                "answer the tick of the last block")
        self._answers[tick] = voltage_v

    def awaited(self, tick):
        """Whether ``tick`` cannot be played yet without missing an answer."""
        return tick - 1 > self._first_tick and tick - 1 not in self._answers

    def begin(self, tick):
        """Take over the answer that acts in ``tick``; return whether the last is held instead."""
        if tick - 1 <= self._first_tick:
            return False
        held = tick - 1 not in self._answers
        self.voltage_v = self._answers.get(tick - 1, self.voltage_v)
        self.missed += held
        self.missed_in_a_row = self.missed_in_a_row + 1 if held else 0
        # One by one, because answers may come from another thread meanwhile.
        for old in [k for k in list(self._answers) if k < tick]:
            del self._answers[old]
        return held
