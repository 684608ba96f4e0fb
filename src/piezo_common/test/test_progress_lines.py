# SPDX-License-Identifier: BSD-3-Clause
"""Progress of a command: no line comes late, and what is left is no more than the budget."""

import pytest

from piezo_common.budget import Budget
from piezo_common.progress_lines import SILENT_S, ProgressLines, progress_printed


class Clock:
    """Seconds that pass when a test says so."""

    def __init__(self):
        self.seconds = 0.0

    def __call__(self):
        return self.seconds


@pytest.fixture
def clock():
    return Clock()


def test_a_long_step_is_printed_again_with_what_is_left(clock, capsys):
    lines = ProgressLines(Budget(None, clock), clock)
    lines.report("creep", 0.0)
    clock.seconds = 10.0
    lines.report("dynamics", 0.25)
    for _ in range(2):
        clock.seconds += 0.5 * SILENT_S
        lines.beat()
    assert capsys.readouterr().out.splitlines() == [
        "  0 %  creep",
        " 25 %  dynamics, 10 s so far, about 30 s left",
        " 25 %  dynamics, 14 s so far, about 42 s left"]


def test_no_more_is_left_than_the_budget_has(clock, capsys):
    lines = ProgressLines(Budget(20.0, clock), clock)
    clock.seconds = 10.0
    lines.report("dynamics", 0.1)
    assert capsys.readouterr().out.endswith("about 10 s left\n")


def test_a_step_that_ends_later_than_the_budget_promises_no_time(clock, capsys):
    lines = ProgressLines(Budget(20.0, clock), clock)
    clock.seconds = 21.0
    lines.report("dynamics", 0.1)
    assert capsys.readouterr().out.endswith("21 s so far; the time is over, this step ends\n")


def test_the_lines_end_with_their_context(capsys):
    with progress_printed(Budget()) as progress:
        progress("creep", 0.0)
    assert capsys.readouterr().out == "  0 %  creep\n"
