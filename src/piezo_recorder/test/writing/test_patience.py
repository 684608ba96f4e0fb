# SPDX-License-Identifier: BSD-3-Clause
"""What gets on is waited for, however slowly; what stands still is given up."""

from piezo_recorder.node.patience import Patience


class Clock:
    now_s = 100.0

    def __call__(self):
        return self.now_s


def ends_after(states, step_s=1.0, limit_s=5.0):
    """Seconds until the patience with states that follow each other ends; None if it does not."""
    clock = Clock()
    patience = Patience(limit_s, clock)
    for state in states:
        clock.now_s += step_s
        if patience.ended(state):
            return clock.now_s - 100.0
    return None


def test_progress_is_waited_for_however_long_it_takes():
    assert ends_after(range(1000), step_s=4.9) is None


def test_what_gets_on_no_more_is_given_up_after_the_limit():
    assert ends_after([3, 2, 1, *[1] * 20]) == 3.0 + 6.0


def test_what_never_gets_on_is_given_up_after_the_limit():
    assert ends_after([None] * 20) == 6.0
