# SPDX-License-Identifier: BSD-3-Clause
"""Which feedback answers act, and how far; requests that come twice."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezo_stage_driver.engine.feedback_hold import FeedbackHold
from piezo_stage_driver.safety.answer_gate import AnswerGate
from piezo_stage_driver.safety.limits import (
    FLAG_RANGE_LIMITED,
    FLAG_SLEW_LIMITED,
    FeedbackLimits,
    VoltageLimits,
)
from piezo_stage_driver.safety.request_memory import REMEMBERED_REQUESTS, RequestMemory

LIMITS = FeedbackLimits(maximum_v=20.0, maximum_step_v=4.0, patience=2)


def held(*answers, limits=LIMITS):
    """Return the feedback of every tick whose answers are these; None stands for none."""
    hold, voltage_v = FeedbackHold(0, limits=limits), []
    for tick, answer_v in enumerate(answers, start=1):
        if answer_v is not None:
            hold.answer(tick, answer_v, tick)
        hold.begin(tick + 1)
        voltage_v.append(hold.voltage_v)
    return voltage_v, hold


def test_answer_after_many_that_were_missed_goes_on_by_bounded_steps():
    voltage_v, hold = held(1.0, None, None, None, None, 15.0, 15.0, 15.0)
    assert voltage_v == [1.0, 1.0, 1.0, 1.0, 1.0, 5.0, 9.0, 13.0]
    assert hold.missed == 4
    assert "3 feedback answers in a row" in hold.cause


def test_answer_beyond_the_limit_does_not_act_and_several_in_a_row_are_a_cause():
    voltage_v, hold = held(2.0, 1e308, -1e6, 3.0, 21.0)
    assert voltage_v == [2.0, 2.0, 2.0, 3.0, 3.0]
    assert (hold.limited, hold.limited_in_a_row, hold.cause) == (3, 1, "")
    assert held(21.0, 21.0, 21.0)[1].cause


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False) | st.none(), max_size=30))
def test_feedback_is_bounded_whatever_is_answered(answers):
    voltage_v, _ = held(*answers)
    assert np.abs(voltage_v).max(initial=0.0) <= 20.0
    assert np.abs(np.diff(voltage_v, prepend=0.0)).max(initial=0.0) <= 4.0 + 1e-9


class LateDict(dict):
    """An answer that comes between two looks at the answers, as from another thread."""

    def __init__(self, tick, voltage_v):
        super().__init__()
        self._late = (tick, voltage_v)

    def _after_a_look(self):
        if self._late:
            (tick, voltage_v), self._late = self._late, None
            self[tick] = voltage_v

    def __contains__(self, tick):
        there = super().__contains__(tick)
        self._after_a_look()
        return there

    def pop(self, *arguments):
        value = super().pop(*arguments)
        self._after_a_look()
        return value


def test_answer_that_comes_while_its_tick_begins_is_missed_or_acts_but_not_both():
    hold = FeedbackHold(0)
    hold._answers = LateDict(1, 5.0)
    missed = hold.begin(2)
    assert missed == (hold.voltage_v == 0.0)
    assert hold.missed == missed


def test_answers_to_ticks_long_gone_take_no_room():
    hold = FeedbackHold(0)
    for tick in range(1000):
        hold.answer(tick, 1.0, 1000)
    assert len(hold._answers) == 1


# Runs

def test_only_the_present_run_is_answered():
    gate = AnswerGate()
    first = gate.begin()
    assert gate.admits(first, alone=False)
    second = gate.begin()
    assert second == first + 1
    assert not gate.admits(first, alone=True)
    assert (gate.stale, gate.foreign, gate.cause) == (1, 0, "")
    assert gate.admits(second, alone=False)
    assert not gate.admits(second + 1, alone=False)
    assert gate.foreign == 1 and "others than the client" in gate.cause
    gate.begin()
    assert gate.cause == ""


def test_answer_without_a_number_acts_only_where_nobody_else_could_have_sent_it():
    gate = AnswerGate(max_foreign=2)
    run = gate.begin()
    assert gate.admits(0, alone=True)
    assert not gate.admits(0, alone=False)
    assert gate.admits(run, alone=True)
    assert not gate.admits(0, alone=True)  # its client gives numbers
    assert gate.cause == ""
    assert not gate.admits(0, alone=True)
    assert gate.cause


def test_two_stages_do_not_number_their_runs_alike():
    assert AnswerGate().begin() != AnswerGate().begin()


# Limits

@pytest.mark.parametrize("wanted_v", [
    [np.nan, 3.0], [1.0, np.nan, np.nan], [np.nan], [1.0, np.inf, np.nan], [-np.inf, np.nan]])
def test_what_is_no_number_never_passes_the_limits(wanted_v):
    limits = VoltageLimits(-20.0, 120.0, 40_000.0)
    voltage_v, flags = limits.apply(np.array(wanted_v), 2.0, 25e-6)
    assert np.isfinite(voltage_v).all()
    assert flags & (FLAG_RANGE_LIMITED | FLAG_SLEW_LIMITED)
    assert np.abs(np.diff(voltage_v, prepend=2.0)).max() <= 1.0 + 1e-6


def test_nan_holds_the_voltage_before_it():
    limits = VoltageLimits(-20.0, 120.0, 2.0e6)
    voltage_v, _ = limits.apply(np.array([np.nan, 3.0, np.nan, np.nan, 4.0]), 2.0, 25e-6)
    assert voltage_v.tolist() == [2.0, 3.0, 3.0, 3.0, 4.0]


# Requests

def test_request_that_comes_twice_shares_the_answer_of_the_first():
    memory, shared = RequestMemory(), []
    first = SimpleNamespace(share=shared.append)
    assert not memory.repeats(5, first)
    assert memory.repeats(5, "second")
    assert shared == ["second"]
    assert not memory.repeats(0, first) and not memory.repeats(0, first)
    for number in range(6, 6 + REMEMBERED_REQUESTS):
        assert not memory.repeats(number, first)
    assert not memory.repeats(5, first)
