# SPDX-License-Identifier: BSD-3-Clause
"""Commands of clients by a name, for tests that draw or list them."""

from piezo_stage_driver.safety.commands import Command
from piezo_stage_driver.safety.transitions import Event

CALLS = {
    "play": (Event.PLAY, "play"),
    "load_feedforward": (Event.LOAD, "load_feedforward"),
    "append_feedforward": (Event.APPEND, "load_feedforward"),
    "load_feedback": (Event.LAW, "load_feedback"),
    "replace_feedforward": (Event.REPLACE, "replace_feedforward"),
    "start_tracking": (Event.TRACK, "start_tracking"),
    "stop_tracking": (Event.END_TRACKING, "stop_tracking"),
    "reset": (Event.RESET, "reset"),
}


def command(name, *arguments, **options):
    """Make the command that calls a method of the stage's commands."""
    event, method = CALLS[name]
    if event is Event.RESET and arguments:
        options["asked_s"] = arguments[0]
    return Command(event, lambda stage: getattr(stage, method)(*arguments), **options)
