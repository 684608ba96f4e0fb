# SPDX-License-Identifier: BSD-3-Clause
"""What an answer takes is what it computes, not what it waits for the processor."""

import time
from functools import partial

import numpy as np

import piezo_controller.feedback.stage_design as module

WAIT_S = 2e-3


class WaitingFeedback:
    """Gives the processor to others in each of its answers."""

    def __init__(self, controller=None):
        self.answers = 0

    def step(self, expected_um, measured_um):
        time.sleep(WAIT_S)
        self.answers += 1

    def reset(self):
        self.answers = 0


def test_time_of_other_programs_does_not_count_for_a_design(monkeypatch):
    monkeypatch.setattr(module, "MultirateFeedback", WaitingFeedback)
    monkeypatch.setattr(module, "WARM_UP", 0)
    monkeypatch.setattr(module, "answer_times_s", partial(module.answer_times_s, repeats=20))
    assert module.computing_time_s() < WAIT_S
    waited_s = module.answer_times_s(WaitingFeedback(), 40)
    assert waited_s.shape == (20,) and np.all(waited_s >= WAIT_S)
