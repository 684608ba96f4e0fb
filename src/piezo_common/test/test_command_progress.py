# SPDX-License-Identifier: BSD-3-Clause
"""Progress of a command: no line comes late, and what is left is no more than the budget."""

import re

import pytest

from piezo_common.budget import Budget
from piezo_common.progress_line import SILENT_S, CommandProgress, progress_printed


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
    lines = CommandProgress(Budget(None, clock), clock)
    lines.report("creep", 0.0)
    clock.seconds = 10.0
    lines.report("dynamics", 0.25)
    for _ in range(2):
        clock.seconds += 0.5 * SILENT_S
        lines.beat()
    assert capsys.readouterr().out.splitlines() == [
        "  0 %  creep",
        " 25 %  dynamics, 10 s so far, about 30 s left",
        " 25 %  dynamics, 14 s so far, about 26 s left"]


def test_a_step_that_takes_longer_than_all_that_was_left_says_so(clock, capsys):
    lines = CommandProgress(Budget(None, clock), clock)
    clock.seconds = 9.0
    lines.report("dynamics", 0.9)
    clock.seconds += SILENT_S
    lines.beat()
    assert capsys.readouterr().out.splitlines()[-1] == (
        " 90 %  dynamics, 13 s so far, longer than expected")


def test_a_terminal_shows_one_line_that_is_cleared_at_the_end(capsys, monkeypatch):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "20")
    with progress_printed(Budget()) as progress:
        progress("a step with a long name", 0.0)
        progress("short", 0.5)
    shown = capsys.readouterr().out
    assert "\n" not in shown
    assert shown.split("\r\x1b[K") == ["", "  0 %  a step with \r", " 50 %  short\r", "\r"]


def test_a_last_step_that_begins_early_is_not_said_to_be_late(clock, capsys):
    lines = CommandProgress(Budget(None, clock), clock)
    clock.seconds = 3.0
    lines.report("write the report", 0.9)
    assert capsys.readouterr().out == " 90 %  write the report, 3 s so far\n"


def test_steps_that_take_their_parts_of_the_time_leave_what_is_left(clock, capsys):
    whole_s, parts = 200.0, (0.0, 0.02, 0.1, 0.12, 0.3, 0.85, 0.9, 1.0)
    lines = CommandProgress(Budget(None, clock), clock)
    for begin, end in zip(parts[:-1], parts[1:], strict=True):
        lines.report("step", begin)
        while clock.seconds < end * whole_s:
            clock.seconds = min(clock.seconds + 1.0, end * whole_s)
            lines.beat()
    printed = [re.search(r"(\d+) s so far, about (\d+) s left", line)
               for line in capsys.readouterr().out.splitlines()]
    told = [tuple(map(float, found.groups())) for found in printed if found]
    assert len(told) > 30
    assert all(taken_s + left_s == pytest.approx(whole_s, abs=1.0) for taken_s, left_s in told)


def test_no_more_is_left_than_the_budget_has(clock, capsys):
    lines = CommandProgress(Budget(20.0, clock), clock)
    clock.seconds = 10.0
    lines.report("dynamics", 0.1)
    assert capsys.readouterr().out.endswith("about 10 s left\n")


def test_a_step_that_ends_later_than_the_budget_promises_no_time(clock, capsys):
    lines = CommandProgress(Budget(20.0, clock), clock)
    clock.seconds = 21.0
    lines.report("dynamics", 0.1)
    assert capsys.readouterr().out.endswith("21 s so far; the time is over, this step ends\n")


def test_the_lines_end_with_their_context(capsys):
    with progress_printed(Budget()) as progress:
        progress("creep", 0.0)
    assert capsys.readouterr().out == "  0 %  creep\n"
