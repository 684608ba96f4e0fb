# SPDX-License-Identifier: BSD-3-Clause
"""Work that ends when its time is over, with what it has found."""

import pytest

from piezo_common.budget import Budget, has_time_for, is_time_up, spending, while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_common.side_by_side import side_by_side


class Clock:
    """Seconds that pass when a test says so."""

    def __init__(self):
        self.seconds = 0.0

    def __call__(self):
        return self.seconds


@pytest.fixture
def clock():
    return Clock()


def steps_until_the_end(clock, what="further steps", share=1.0):
    """Return how many steps of a second a block takes, 20 at most."""
    done = 0
    with while_time_lasts(what, share):
        for _ in range(20):
            check_cancelled()
            clock.seconds += 1.0
            done += 1
    return done


def test_a_block_ends_when_its_share_of_the_time_is_over(clock):
    budget = Budget(10.0, clock)
    with spending(budget):
        assert steps_until_the_end(clock, share=0.4) == 4
        assert steps_until_the_end(clock, "others") == 6
        assert steps_until_the_end(clock) == 0
    assert budget.left_s == 0.0
    assert budget.sentence() == (
        "the time of 10 s does not suffice; not tried: further steps; others")


def test_what_was_taken_before_and_what_is_to_be_written_count(clock):
    budget = Budget(10.0, clock, taken_s=3.0, to_write_s=2.0)
    with spending(budget):
        assert steps_until_the_end(clock) == 5
    assert budget.left_s == 2.0
    assert budget.sentence() == "the time of 10 s does not suffice; not tried: further steps"


def test_without_a_budget_all_is_done(clock):
    assert steps_until_the_end(clock) == 20
    with spending(Budget(clock=clock)) as nothing:
        assert nothing is None and steps_until_the_end(clock) == 20


def test_work_for_which_there_is_no_time_is_noted(clock):
    budget = Budget(10.0, clock)
    with spending(budget):
        clock.seconds = 6.0
        assert has_time_for("most", 0.7) and not has_time_for("half", 0.5)
    assert budget.not_tried == ["half"]


def test_ctrl_c_ends_its_block_and_all_that_follow(clock):
    budget, found = Budget(None, clock), []
    with spending(budget):
        with while_time_lasts("more") as part:
            found.append(1)
            raise KeyboardInterrupt
        assert part.was_cut and found == [1]
        assert steps_until_the_end(clock, "later") == 0
    assert budget.is_interrupted
    assert budget.sentence() == "interrupted; not tried: more; later"


def test_what_fails_is_not_hidden(clock):
    with spending(Budget(10.0, clock)), pytest.raises(ValueError, match="wrong"), \
            while_time_lasts("more"):
        raise ValueError("wrong")


def test_a_search_may_ask_and_keep_what_it_has(clock):
    budget = Budget(10.0, clock)
    with spending(budget), while_time_lasts("more", 0.5):
        assert not is_time_up()
        clock.seconds = 5.0
        assert is_time_up()
    assert not budget.not_tried


@pytest.mark.parametrize("threads", [1, 2])
def test_items_side_by_side_end_with_the_block_around_them(clock, threads):
    done = []

    def work(item):
        done.append(item)
        clock.seconds += 2.0

    with spending(Budget(10.0, clock)), while_time_lasts("more", 1.0):
        side_by_side(work, range(100), threads=threads)
    assert 5 <= len(done) <= 5 + threads


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan")])
def test_a_time_that_is_not_positive_is_refused(seconds):
    with pytest.raises(ValueError, match=f"{seconds:g} s: give a positive"):
        Budget(seconds)
