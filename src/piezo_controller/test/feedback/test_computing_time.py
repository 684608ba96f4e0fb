# SPDX-License-Identifier: BSD-3-Clause
"""What an answer takes is what it computes, not what it waits for the processor."""

from types import SimpleNamespace

import numpy as np
import pytest

import piezo_controller.feedback.stage_design as module

ANSWER_S = 30e-6
WAIT_S = 2e-3
TICK_S = 4e-3
"""Resolution of the processor time on some kernels."""


class WaitingFeedback:
    """Computes in each of its answers, and gives the processor to others meanwhile."""

    computed_s = waited_s = 0.0

    def __init__(self, controller=None):
        pass

    def step(self, expected_um, measured_um):
        WaitingFeedback.computed_s += ANSWER_S
        WaitingFeedback.waited_s += WAIT_S

    def reset(self):
        pass


def of_the_wall():
    return WaitingFeedback.computed_s + WaitingFeedback.waited_s


def of_the_processor():
    return WaitingFeedback.computed_s


def of_the_processor_in_ticks():
    return np.floor(WaitingFeedback.computed_s / TICK_S) * TICK_S


@pytest.mark.parametrize("processor", [of_the_processor, of_the_processor_in_ticks])
def test_time_of_other_programs_does_not_count_for_a_design(monkeypatch, processor):
    monkeypatch.setattr(module, "MultirateFeedback", WaitingFeedback)
    monkeypatch.setattr(module, "time", SimpleNamespace(
        thread_time=processor, perf_counter=of_the_wall))
    assert module.computing_time_s() == pytest.approx(ANSWER_S, rel=0.1)


def test_answers_are_timed_one_by_one():
    waited_s = module.answer_times_s(WaitingFeedback(), 40, 20, of_the_wall)
    assert waited_s == pytest.approx(np.full(20, ANSWER_S + WAIT_S))
