# SPDX-License-Identifier: BSD-3-Clause
"""docs/stage_states.md is what the supervisor goes by, and the table leaves nothing open."""

from pathlib import Path

import stage_table

from piezo_stage_driver.safety.transitions import COMMANDS, STATES, TRANSITIONS, Event, State

ROOT = Path(__file__).parents[1]


def test_page_in_the_docs_is_the_table_of_the_supervisor():
    assert (ROOT / "docs" / "stage_states.md").read_text() == stage_table.page()
    assert stage_table.main(["--check"]) == 0


def test_every_state_is_described_and_can_be_reached_and_left():
    assert set(STATES) == set(State)
    assert {to.to for to in TRANSITIONS.values()} == set(State)
    assert {state for (state, _), to in TRANSITIONS.items() if to.to is not state} == set(State)


def test_every_event_has_its_place():
    assert {event for _, event in TRANSITIONS} == set(Event)
    assert set(COMMANDS) <= set(Event)


def test_a_stop_is_taken_in_every_state_and_leads_to_no_motion():
    for state in State:
        assert TRANSITIONS[state, Event.STOP].to in (
            State.STOPPING, State.INACTIVE, State.FAULTED)


def test_after_a_fault_the_backend_is_asked_for_nothing_until_the_next_activation():
    for (state, event), to in TRANSITIONS.items():
        if state is State.FAULTED:
            assert to.backend == "nothing"
        elif event is Event.FAULT:
            assert to == (State.FAULTED, "close, and nothing else until the next activation")
