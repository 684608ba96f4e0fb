# SPDX-License-Identifier: BSD-3-Clause
"""The states of a stage and the transitions between them, in one table.

The supervisor uses only this table, and docs/stage_states.md is generated from it.
"""

from enum import StrEnum
from typing import NamedTuple


class State(StrEnum):
    """States of a stage."""

    INACTIVE = "inactive"
    IDLE = "idle"
    PLAYING = "playing"
    TRACKING = "tracking"
    STOPPING = "stopping"
    LATCHED = "latched"
    FAULTED = "faulted"


class Event(StrEnum):
    """Events that lead from one state to another."""

    ACTIVATE = "activate"
    PLAY = "play_waveform"
    LOAD = "load_feedforward"
    APPEND = "load_feedforward, append"
    LAW = "load_feedback"
    REPLACE = "replace_feedforward"
    TRACK = "start_tracking"
    END_TRACKING = "stop_tracking"
    RESET = "reset"
    STOP = "stop"
    RETURN = "the way to rest begins"
    OVER = "the end is reached"
    REST = "rest is reached"
    REST_LATCHED = "rest is reached, a cause is kept"
    REST_LEAVING = "rest is reached, the stage is being deactivated"
    LEAVE = "deactivate"
    FAULT = "the backend fails"
    GIVE_UP = "the backend hangs and is given up"


COMMANDS = (Event.PLAY, Event.LOAD, Event.APPEND, Event.LAW, Event.REPLACE, Event.TRACK,
            Event.END_TRACKING, Event.RESET)
"""Events that a client requests; refused if the table has no entry."""

STATES = {
    State.INACTIVE: ("The backend is closed.", "nobody"),
    State.IDLE: ("Nothing plays: the voltage is held, at rest or where a waveform left it.",
                 "any client"),
    State.PLAYING: ("A waveform plays, its approach and its way back included.",
                    "the goal's client, by cancelling it"),
    State.TRACKING: ("The feedforward plays; the answers that bear the number of the run act, or "
                     "a law on board.",
                     "any client: append, stop_tracking, and load_feedback under a law; clients "
                     "that know the number of the run: replace_feedforward"),
    State.STOPPING: ("The voltage returns to rest at ramp_rate_v_per_s.", "nobody"),
    State.LATCHED: ("At rest after a stop whose cause is kept.", "any client: reset"),
    State.FAULTED: ("The backend has failed or is given up. The node deactivates itself.",
                    "nobody"),
}
"""Meaning of each state, and the commands accepted in it. emergency_stop is always accepted."""


class Transition(NamedTuple):
    """The state after an event, and the action of the backend."""

    to: State
    backend: str


RAMP = "exchange: the ramp to rest, from the next tick on"
GO_ON = "exchange, as before"
NOTHING = "nothing"
CLOSE_ALONE = "close, and nothing else until the next activation"
GIVEN_UP = "emergency_rest where it has one; close once its call has returned"

MOVING = (State.PLAYING, State.TRACKING, State.STOPPING)
OPEN = (State.IDLE, *MOVING, State.LATCHED)

TRANSITIONS = {
    (State.INACTIVE, Event.ACTIVATE): Transition(State.IDLE, "open"),
    (State.INACTIVE, Event.STOP): Transition(State.INACTIVE, NOTHING),
    (State.INACTIVE, Event.RESET): Transition(State.INACTIVE, NOTHING),
    (State.INACTIVE, Event.LEAVE): Transition(State.INACTIVE, NOTHING),
    (State.IDLE, Event.PLAY): Transition(
        State.PLAYING, "exchange: the approach, the waveform, the way back"),
    (State.IDLE, Event.LOAD): Transition(State.IDLE, NOTHING),
    (State.IDLE, Event.APPEND): Transition(State.IDLE, NOTHING),
    (State.IDLE, Event.LAW): Transition(State.IDLE, NOTHING),
    (State.TRACKING, Event.LAW): Transition(State.TRACKING, GO_ON),
    (State.TRACKING, Event.REPLACE): Transition(State.TRACKING, GO_ON),
    (State.IDLE, Event.TRACK): Transition(
        State.TRACKING, "exchange: feedforward, and answers or a law"),
    (State.IDLE, Event.RESET): Transition(State.IDLE, NOTHING),
    (State.PLAYING, Event.OVER): Transition(State.IDLE, GO_ON),
    (State.TRACKING, Event.OVER): Transition(State.IDLE, GO_ON),
    (State.PLAYING, Event.APPEND): Transition(State.PLAYING, GO_ON),
    (State.TRACKING, Event.APPEND): Transition(State.TRACKING, GO_ON),
    (State.TRACKING, Event.END_TRACKING): Transition(State.STOPPING, RAMP),
    (State.PLAYING, Event.RETURN): Transition(State.STOPPING, RAMP),
    (State.TRACKING, Event.RETURN): Transition(State.STOPPING, RAMP),
    (State.STOPPING, Event.APPEND): Transition(State.STOPPING, GO_ON),
    (State.STOPPING, Event.REST): Transition(State.IDLE, GO_ON),
    (State.STOPPING, Event.REST_LATCHED): Transition(State.LATCHED, GO_ON),
    (State.STOPPING, Event.REST_LEAVING): Transition(State.INACTIVE, "close"),
    (State.LATCHED, Event.RESET): Transition(State.IDLE, GO_ON),
    (State.FAULTED, Event.STOP): Transition(State.FAULTED, NOTHING),
    (State.FAULTED, Event.RESET): Transition(State.FAULTED, NOTHING),
    (State.FAULTED, Event.LEAVE): Transition(State.INACTIVE, NOTHING),
    **{(state, Event.STOP): Transition(State.STOPPING, RAMP) for state in OPEN},
    **{(state, Event.LEAVE): Transition(State.STOPPING, RAMP) for state in OPEN},
    **{(state, Event.FAULT): Transition(State.FAULTED, CLOSE_ALONE) for state in OPEN},
    **{(state, Event.GIVE_UP): Transition(State.FAULTED, GIVEN_UP) for state in OPEN},
}

FAULTS = (
    ("a guard of the sensor or the feedback; answers missed in a row", "stop"),
    ("a feedback law whose declared gain is another than the approach shows, or that makes the "
     "error larger by more than its max_error_um", "stop"),
    ("answers beyond max_feedback_v or max_feedback_step_v in a row", "stop"),
    ("answers of others than the client of the run", "stop"),
    ("the client is gone", "stop"),
    ("emergency_stop", "stop"),
    ("the backend does not return from exchange within exchange_timeout_s",
     "stop: the ramp begins when it returns; emergency_rest where it has one"),
    ("the backend raises BackendFault", "faulted, close; the backend has ramped by itself"),
    ("the backend raises anything else, or returns what is no displacement per voltage",
     "faulted, close; where the amplifier stands is not known"),
    ("the stage is deactivated or ended while the backend hangs", "given up"),
)
"""Effect of each fault."""
