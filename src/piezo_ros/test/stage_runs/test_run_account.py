# SPDX-License-Identifier: BSD-3-Clause
"""A run counts as done only if the stage played what it was asked to."""

import pytest
from piezo_interfaces.msg import SampleBlock

from piezo_ros.stage_runs.run_account import RunAccount

LATE, RANGE, SLEW, STARVED = (
    SampleBlock.FLAG_FEEDBACK_HELD, SampleBlock.FLAG_RANGE_LIMITED,
    SampleBlock.FLAG_SLEW_LIMITED, SampleBlock.FLAG_FEEDFORWARD_HELD)


def account_of(flags, ticks=1000, **options):
    """Return the account of a run whose first blocks bear these flags."""
    account = RunAccount(1.0, 2.0, **options)
    for number in range(ticks):
        account.take(SampleBlock.FLAG_TRACKING | (flags[number] if number < len(flags) else 0))
    return account


def test_flawless_run_counts_and_tells_nothing():
    account = account_of([])
    assert (account.failure, account.note) == ("", "")


@pytest.mark.parametrize(("flag", "allowed", "note"), [
    (LATE, 10, "10 of 1000 answers were late"),
    (RANGE, 20, "the stage limited the voltage in 20 of 1000 ticks"),
    (SLEW, 20, "the stage limited the voltage in 20 of 1000 ticks"),
])
def test_few_flaws_are_told_and_more_fail_the_run(flag, allowed, note):
    account = account_of([flag] * allowed)
    assert (account.failure, account.note) == ("", note)
    failure = account_of([flag] * (allowed + 1)).failure
    assert failure.startswith(note.replace(f"{allowed} of", f"{allowed + 1} of"))
    assert ", more than max_" in failure


def test_tick_that_is_limited_twice_counts_once():
    assert account_of([RANGE | SLEW] * 20).failure == ""


def test_late_answers_that_do_not_act_do_not_count():
    assert account_of([LATE] * 1000, answered=False).failure == ""


def test_stream_that_is_late_once_fails_the_run():
    assert "the feedforward arrived too late for 1 of 1000 ticks" in account_of(
        [STARVED], streamed=True).failure
    assert account_of([STARVED] * 1000).failure == ""
