# SPDX-License-Identifier: BSD-3-Clause
"""A command acts once or never, and never late."""

from piezo_stage_driver.safety.commands import Command, CommandQueue
from piezo_stage_driver.safety.transitions import Event


class Waiting:
    """A queue, its clock, and what the clients were told."""

    def __init__(self, *events):
        self.now_s, self.refusals = 0.0, []
        self.queue = CommandQueue(5.0, lambda: self.now_s)
        for event in events:
            self.queue.put(Command(event, lambda stage: None,
                                   on_done=lambda value, error: self.refusals.append(error)))


def test_command_that_has_waited_too_long_is_refused_where_nobody_looked_but_the_loop():
    waiting = Waiting(Event.PLAY)
    waiting.now_s = 5.0
    assert waiting.queue.take() is None
    assert "is withdrawn" in str(waiting.refusals)


def test_command_is_taken_once_in_its_turn_as_long_as_it_may_run():
    waiting = Waiting(Event.LOAD, Event.PLAY)
    waiting.now_s = 4.9
    assert [waiting.queue.take().event for _ in range(2)] == [Event.LOAD, Event.PLAY]
    assert waiting.queue.take() is None
    waiting.now_s = 9.0
    waiting.queue.expire()
    waiting.queue.drain("the stage is stopped")
    assert waiting.refusals == []


def test_command_that_was_refused_is_not_taken():
    waiting = Waiting(Event.PLAY)
    waiting.queue.drain("the stage is stopped")
    assert waiting.queue.take() is None
    assert [str(error) for error in waiting.refusals] == ["the stage is stopped"]
