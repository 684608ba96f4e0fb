# SPDX-License-Identifier: BSD-3-Clause
"""What the supervisor lets happen: a machine of invariants also passes where nothing ever acts."""

import time

import numpy as np
import pytest
from commands_by_name import command

from piezo_stage_driver.engine.blocks import FLAG_STOPPED
from piezo_stage_driver.engine.feedback_hold import FeedbackError
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.limits import VoltageLimits
from piezo_stage_driver.safety.supervisor import StageSupervisor
from piezo_stage_driver.safety.transitions import State

PERIOD_S, TICK = 1 / 40_000.0, 40
TIME_LIMIT_TICKS = 1000


class Backend:
    """A stage that follows its voltage."""

    sample_rate_hz = 40_000.0

    def __init__(self):
        self.voltage_v = 0.0

    def open(self):
        pass

    def exchange(self, voltage_v):
        self.voltage_v = float(voltage_v[-1])
        return voltage_v.copy()

    def close(self):
        pass


class Goal:
    """Note what the client of a waveform is told."""

    cancelled = False

    def __init__(self):
        self.phases, self.ends = [], []

    def attend(self, engine):
        assert not self.ends and 0.0 <= engine.fraction <= 1.0
        self.phases.append(engine.phase_name)

    def end(self, cause, last_sample):
        self.ends.append((cause, last_sample))


class Stage:
    """A supervisor that is active, and what became of the commands."""

    def __init__(self, closing_ticks=0, samples_per_block=1):
        self.backend, self.told = Backend(), []
        self.supervisor = StageSupervisor(
            self.backend, lambda backend, latch: StageEngine(
                backend, VoltageLimits(-20.0, 120.0, 2.0e5), 0.0, 2.0e4, TICK, latch=latch,
                samples_per_block=samples_per_block),
            closing_ticks=closing_ticks)
        self.supervisor.activate()

    def ask(self, name, *arguments, goal=None):
        self.supervisor.submit(command(
            name, *arguments, goal=goal, on_done=lambda value, error: self.told.append(
                value if error is None else str(error))))

    def tick_until(self, state):
        for _ in range(TIME_LIMIT_TICKS):
            if self.supervisor.state is state:
                return
            self.supervisor.tick()
        raise AssertionError(f"the stage is {self.supervisor.state}, never {state}")

    def track(self):
        self.ask("load_feedforward", np.full(4000, 0.0), [], False)
        self.ask("start_tracking", True)
        self.supervisor.tick()
        run, _ = self.told[-1]
        return run


@pytest.fixture
def stage():
    return Stage()


def test_waveform_plays_returns_and_its_client_is_told_of_its_end_once(stage):
    goal = Goal()
    stage.ask("play", np.full(400, 60.0), PERIOD_S, goal=goal)
    stage.supervisor.tick()
    (first, samples), = stage.told
    assert samples == 400 and stage.supervisor.state is State.PLAYING
    assert goal.phases == ["approach"]
    assert stage.supervisor.has_work and not stage.supervisor.at_rest
    stage.tick_until(State.STOPPING)
    assert stage.supervisor.engine.next_sample == first + samples
    stage.tick_until(State.IDLE)
    assert goal.ends == [("", stage.supervisor.engine.last_sample)]
    assert stage.supervisor.at_rest and not stage.supervisor.has_work


def test_stop_leads_back_from_the_next_tick_on_and_latches_at_rest(stage):
    goal = Goal()
    stage.ask("play", np.full(4000, 60.0), PERIOD_S, goal=goal)
    while stage.backend.voltage_v < 60.0:
        stage.supervisor.tick()
    stage.supervisor.stop("somebody stopped it")
    block = stage.supervisor.tick()
    assert stage.supervisor.state is State.STOPPING and block.flags & FLAG_STOPPED
    assert stage.backend.voltage_v < 60.0
    stage.tick_until(State.LATCHED)
    assert stage.backend.voltage_v == 0.0 and goal.ends[0][0] == "somebody stopped it"
    assert not stage.supervisor.has_work
    stage.ask("play", [0.0], PERIOD_S)
    stage.ask("reset")
    stage.supervisor.tick()
    assert "somebody stopped it" in stage.told[-2] and stage.told[-1] is None
    assert stage.supervisor.state is State.IDLE and stage.supervisor.cause == ""


def test_reset_that_was_asked_for_before_the_last_stop_does_not_release_it(stage):
    stage.supervisor.stop("the first")
    stage.tick_until(State.LATCHED)
    asked_s = time.monotonic()
    stage.supervisor.stop("the second")
    stage.ask("reset", asked_s)
    stage.supervisor.tick()
    assert "stopped after this was asked for (the first)" in stage.told[-1]
    assert stage.supervisor.cause
    stage.ask("reset", time.monotonic())
    stage.supervisor.tick()
    assert stage.told[-1] is None and not stage.supervisor.cause


def test_reset_asked_for_before_the_stop_of_a_stage_that_is_not_active_is_refused(stage):
    stage.supervisor.leave("it was deactivated")
    stage.tick_until(State.INACTIVE)
    asked_s = time.monotonic()
    stage.supervisor.stop("somebody stopped it")
    stage.ask("reset", asked_s)
    assert "stopped after this was asked for" in stage.told[-1] and stage.supervisor.cause


def test_run_goes_on_where_a_stop_was_asked_for_before_it_began(stage):
    asked_s = time.monotonic()
    stage.track()
    stage.ask("stop_tracking", asked_s)
    stage.supervisor.tick()
    assert "began after this was asked for" in stage.told[-1]
    assert stage.supervisor.state is State.TRACKING
    stage.ask("stop_tracking", time.monotonic())
    stage.supervisor.tick()
    assert stage.told[-1] is None


def test_cancelled_waveform_returns_to_rest_from_the_next_tick_on(stage):
    goal = Goal()
    stage.ask("play", np.full(4000, 60.0), PERIOD_S, goal=goal)
    while stage.backend.voltage_v < 60.0:
        stage.supervisor.tick()
    goal.cancelled = True
    stage.supervisor.tick()
    assert stage.supervisor.state is State.STOPPING and stage.backend.voltage_v < 60.0
    stage.tick_until(State.IDLE)
    assert len(goal.ends) == 1 and stage.supervisor.cause == ""


def test_answer_of_the_run_acts_and_that_of_a_stranger_stops_the_stage(stage):
    run = stage.track()
    assert stage.supervisor.state is State.TRACKING
    for _ in range(3):
        stage.supervisor.answer(stage.supervisor.engine.tick, 2.0, run, lambda: True)
        stage.supervisor.tick()
    assert stage.backend.voltage_v == 2.0
    with pytest.raises(FeedbackError, match="bears run 7"):
        stage.supervisor.answer(stage.supervisor.engine.tick, 50.0, 7, lambda: True)
    stage.supervisor.tick()
    assert stage.supervisor.state in (State.STOPPING, State.LATCHED)
    assert "came from others" in stage.supervisor.cause and stage.backend.voltage_v <= 2.0


def test_answer_without_a_number_acts_only_where_one_node_alone_answers(stage):
    stage.track()
    for _ in range(3):
        stage.supervisor.answer(stage.supervisor.engine.tick, 2.0, 0, lambda: True)
        stage.supervisor.tick()
    assert stage.backend.voltage_v == 2.0
    with pytest.raises(FeedbackError, match="bears run 0"):
        stage.supervisor.answer(stage.supervisor.engine.tick, 3.0, 0, lambda: False)
    stage.supervisor.tick()
    assert stage.backend.voltage_v < 2.0 and "others than the client" in stage.supervisor.cause


def test_client_of_a_waveform_is_told_its_end_before_the_next_waveform_and_before_closing():
    stage = Stage(closing_ticks=100)
    first, second = Goal(), Goal()
    stage.ask("play", np.full(40, 1.0), PERIOD_S, goal=first)
    stage.tick_until(State.STOPPING)
    while not stage.supervisor.engine.idle:
        stage.supervisor.tick()
    stage.ask("play", np.full(4000, 1.0), PERIOD_S, goal=second)
    stage.supervisor.tick()
    assert [cause for cause, _ in first.ends] == [""]
    stage.supervisor.leave("the node was deactivated")
    stage.tick_until(State.INACTIVE)
    assert [cause for cause, _ in second.ends] == ["the node was deactivated"]


@pytest.mark.parametrize("closing_ticks", [0, 5])
@pytest.mark.parametrize("hold_at_end", [False, True])
@pytest.mark.parametrize("ends_by", ["itself", "cancel", "stop", "leave", "tracking"])
def test_client_of_a_waveform_is_told_of_its_own_phases_alone_whenever_it_ends(
        ends_by, hold_at_end, closing_ticks):
    for ticks in range(1, 20):  # an approach, a waveform and a return of three ticks each
        stage, goal = Stage(closing_ticks), Goal()
        stage.ask("load_feedforward", np.full(400, 60.0 * hold_at_end), [], False)
        stage.ask("play", np.full(120, 60.0), PERIOD_S, 1, hold_at_end, goal=goal)
        for _ in range(ticks):
            stage.supervisor.tick()
        if ends_by == "cancel":
            goal.cancelled = True
        elif ends_by == "stop":
            stage.supervisor.stop("somebody stopped it")
        elif ends_by == "leave":
            stage.supervisor.leave("the stage was deactivated")
        elif ends_by == "tracking":
            stage.ask("start_tracking", False, 3)
        for _ in range(20):
            stage.supervisor.tick()
        assert len(goal.ends) == 1
        assert set(goal.phases) <= {"approach", "play", "return"}
        assert goal.phases == sorted(goal.phases)  # which is also the order of the alphabet


def test_stage_that_is_left_comes_to_rest_and_takes_nothing_more(stage):
    stage.ask("play", np.full(4000, 60.0), PERIOD_S)
    while stage.backend.voltage_v < 60.0:
        stage.supervisor.tick()
    stage.supervisor.leave("the stage was deactivated")
    stage.ask("play", [0.0], PERIOD_S)
    assert "not active" in stage.told[-1]
    stage.tick_until(State.INACTIVE)
    assert stage.backend.voltage_v == 0.0 and stage.supervisor.at_rest
    assert stage.supervisor.tick() is None


@pytest.mark.parametrize("closing_ticks", [0, 3])
def test_commands_between_two_ticks_each_find_what_the_one_before_left(closing_ticks):
    # Tracking that ends before its first sample leaves the stage at rest with no tick in between.
    stage, goal = Stage(closing_ticks), Goal()
    stage.ask("load_feedforward", np.linspace(0.0, 40.0, 400), [], False)
    stage.ask("start_tracking", True)
    stage.ask("stop_tracking")
    stage.ask("play", np.full(40, 10.0), PERIOD_S, goal=goal)
    stage.supervisor.tick()
    assert stage.supervisor.state is State.PLAYING
    assert not any(isinstance(told, str) for told in stage.told) and len(stage.told) == 4
    for _ in range(TIME_LIMIT_TICKS):
        if goal.ends:
            break
        stage.supervisor.tick()
    assert [cause for cause, _ in goal.ends] == [""]


@pytest.mark.parametrize("ticks", [30, 33])
def test_whole_blocks_hold_what_single_ticks_play(ticks):
    played = []
    for whole_block in (False, True):
        stage = Stage(samples_per_block=400)
        stage.ask("load_feedforward", np.linspace(0.0, 40.0, 40 * ticks), [], False)
        stage.ask("start_tracking", False, ticks)
        calls, blocks = 0, []
        while not blocks or not stage.supervisor.at_rest:
            blocks.append(stage.supervisor.tick(whole_block))
            calls += 1
        blocks = [block for block in blocks if block is not None]
        played.append(([block.first_sample for block in blocks], np.concatenate(
            [block.voltage_v for block in blocks])))
        if whole_block:
            assert calls == len(blocks) < ticks
    assert played[0][0] == played[1][0]
    assert np.array_equal(played[0][1], played[1][1])
    assert played[0][1].max() == 40.0
