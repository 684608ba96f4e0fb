# SPDX-License-Identifier: BSD-3-Clause
"""The fast branch plays what was loaded; the slow one adds what a client answers, a tick later."""

from contextlib import contextmanager

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from piezo_interfaces.msg import SampleBlock

from piezo_client.client import GoalFailed

FLAG_TRACKING, FLAG_STOPPED = SampleBlock.FLAG_TRACKING, SampleBlock.FLAG_STOPPED
FLAG_FEEDBACK_HELD = SampleBlock.FLAG_FEEDBACK_HELD
FLAG_FEEDFORWARD_HELD = SampleBlock.FLAG_FEEDFORWARD_HELD
MAX_MISSED_FEEDBACK = 2


@pytest.fixture(scope="module")
def patient_stage(nodes):
    return nodes.start(namespace="/patient")


@pytest.fixture(scope="module")
def impatient_stage(nodes):
    # Each answer that is left out takes that long, and no other may: not on a busy computer either.
    return nodes.start(namespace="/impatient", lockstep_timeout_s=3.0,
                       max_missed_feedback=MAX_MISSED_FEEDBACK)


@contextmanager
def at_rest(stage):
    """Lend a stage that is at rest before and after."""
    stage.forget()
    yield stage
    stage.answer = None
    stage.until(lambda: stage.trigger("reset").success)
    stage.samples(stage.play([0.0]).last_sample)


@pytest.fixture
def stage(patient_stage):
    """A stage that waits for each answer."""
    with at_rest(patient_stage) as stage:
        yield stage


@pytest.fixture
def impatient(impatient_stage):
    """A stage that does not wait long for answers."""
    with at_rest(impatient_stage) as stage:
        yield stage


def track(stage, ticks, answer=None):
    """Track with feedback; return the samples and the tick in which it began."""
    stage.answer = answer
    response = stage.start_tracking(feedback=True, ticks=ticks)
    assert response.success, response.message
    return stage.samples(), response.first_tick


def test_feedforward_is_played_as_uploaded_once_then_periodically(stage):
    once, period = np.linspace(0, 40, 100), 40 + np.sin(2 * np.pi * np.arange(77) / 77)
    assert stage.load(once, period).success
    response = stage.start_tracking(feedback=False, ticks=20)
    samples = stage.samples()
    assert samples.gapless
    expected = np.r_[once, np.tile(period, 10)][:800]
    assert np.array_equal(samples.since(40 * response.first_tick, 800), expected)
    assert np.array_equal(samples.flagged(FLAG_TRACKING), expected)
    assert samples.voltage_v[-1] == 0.0


def test_streamed_feedforward_goes_on_with_what_is_appended_while_it_plays(suite):
    first, second = np.linspace(0, 40, 400), np.linspace(40, 30, 400)
    blocks = []

    def answer_all_but_the_fifth(block):
        blocks.append(block)
        return 0.0 if len(blocks) != 5 else None

    suite.answer = answer_all_but_the_fifth
    assert suite.load(first).success
    first_tick = suite.start_tracking(feedback=True, ticks=25).first_tick
    # Time stands still until the answer comes.
    suite.until(lambda: len(blocks) >= 5)
    assert suite.load(second, append=True).success
    suite.send_feedback(blocks[4].tick, 0.0)
    samples = suite.samples()
    expected = np.r_[first, second, np.full(200, 30.0)]
    assert np.array_equal(samples.since(40 * first_tick, 1000), expected)
    assert np.array_equal(samples.flagged(FLAG_FEEDFORWARD_HELD), np.full(200, 30.0))


@pytest.mark.parametrize(("once", "period", "append", "sentence"), [
    ([0.0, np.nan], [], False, "voltage sample 1 is not a finite number"),
    ([0.0], [120.1], False, "voltage sample 1 is 120.1 V, outside"),
    ([0.0, 51.0], [], False, "the voltage jumps by 51 V to sample 1"),
    ([0.0], [0.0, 30.0, 60.0], False, "the voltage jumps by 60 V to sample 4"),
    ([], [], False, "the voltage sequence is empty"),
    ([60.0], [], True, "the voltage jumps by 60 V to sample 0"),
])
def test_feedforward_beyond_the_limits_is_refused(stage, once, period, append, sentence):
    assert stage.load([0.0]).success
    response = stage.load(once, period, append)
    assert not response.success
    assert response.message.startswith("load_feedforward refused: ")
    assert sentence in response.message
    # What was loaded before is still there.
    samples, _ = track(stage, 3, lambda block: 0.0)
    assert not samples.voltage_v.any()


def test_feedforward_that_repeats_cannot_be_streamed(stage):
    assert stage.load([0.0], [0.0]).success
    response = stage.load([0.0], append=True)
    assert not response.success
    assert "no streamed feedforward to append to" in response.message


def test_feedforward_that_begins_far_from_the_present_voltage_is_not_started(stage):
    assert stage.load([60.0]).success
    response = stage.start_tracking(feedback=False)
    assert not response.success
    assert "jumps by 60 V" in response.message


def test_answer_to_the_block_of_a_tick_acts_in_the_next_tick(stage):
    assert stage.load([0.0]).success
    samples, first_tick = track(stage, 50, lambda block: 0.01 * block.tick)
    voltage_v = samples.since(40 * first_tick, 50 * 40).reshape(50, 40)
    ticks = first_tick + np.arange(50)
    assert not voltage_v[:2].any()  # the first block to be answered is that of the second tick
    assert np.array_equal(voltage_v[2:], np.repeat(0.01 * (ticks[2:, None] - 1), 40, axis=1))
    assert samples.blocks[-1].missed_feedback == 0


def test_missing_answer_is_counted_and_the_last_one_is_held(impatient):
    assert impatient.load([0.0]).success
    samples, first_tick = track(
        impatient, 20, lambda block: 0.01 * block.tick if block.tick % 8 else None)
    answered = first_tick + np.arange(1, 19)
    answered = np.where(answered % 8 == 0, answered - 1, answered)
    answered = np.where(answered > first_tick, answered, 0)
    voltage_v = samples.since(40 * first_tick, 20 * 40).reshape(20, 40)
    assert np.array_equal(voltage_v[2:, 0], 0.01 * answered)
    missed = sum((first_tick + np.arange(1, 19)) % 8 == 0)
    assert len(samples.flagged(FLAG_FEEDBACK_HELD)) == 40 * missed
    tracked = [block for block in samples.blocks if block.flags & FLAG_TRACKING]
    assert tracked[-1].missed_feedback == missed


def test_answer_that_is_no_number_counts_as_missed(impatient):
    assert impatient.load([0.0]).success
    samples, _ = track(impatient, 4, lambda block: np.nan)
    assert not samples.voltage_v.any()
    assert max(block.missed_feedback for block in samples.blocks) == 2


def test_feedback_cannot_lead_out_of_the_range(stage):
    assert stage.load(np.linspace(0, 119, 400)).success
    samples, first_tick = track(stage, 20, lambda block: 5.0)
    assert np.array_equal(samples.since(40 * first_tick + 400, 400), np.full(400, 120.0))
    assert samples.flagged(SampleBlock.FLAG_RANGE_LIMITED).max() == 120.0
    assert samples.voltage_v.max() == 120.0


def test_client_that_stops_answering_trips_the_watchdog(impatient):
    assert impatient.load(np.linspace(0, 40, 400)).success
    first_answered = []

    def answer(block):
        first_answered.append(block.tick)
        return 1.0 if block.tick < first_answered[0] + 20 else None

    samples, first_tick = track(impatient, 10_000, answer)
    held = samples.flagged(FLAG_FEEDBACK_HELD)
    assert np.array_equal(held, np.full(40 * (MAX_MISSED_FEEDBACK + 1), 41.0))
    assert samples.voltage_v[-1] == 0.0
    assert samples.blocks[-1].flags == FLAG_STOPPED

    cause = "the stage is stopped (3 feedback answers in a row were missed): reset it first"
    with pytest.raises(GoalFailed) as failure:
        impatient.play([1.0])
    assert failure.value.result.message == f"waveform refused: {cause}"
    assert impatient.load([0.0]).message == f"load_feedforward refused: {cause}"
    assert impatient.start_tracking(False).message == f"start_tracking refused: {cause}"
    assert impatient.trigger("reset").success
    assert impatient.load([0.0]).success


def test_emergency_stop_ends_a_waveform_and_is_latched_until_reset(stage):
    goal = stage.begin_play(np.full(4000, 60.0), repeats=1_000_000)
    assert stage.trigger("emergency_stop").success
    status, result = stage.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.message == "emergency stop"
    samples = stage.samples(result.last_sample)
    assert samples.gapless
    assert samples.voltage_v[-1] == 0.0
    assert np.abs(np.diff(samples.flagged(FLAG_STOPPED))).max() < 0.051  # 2000 V/s
    with pytest.raises(GoalFailed, match=r"the stage is stopped \(emergency stop\): reset it"):
        stage.play([1.0])
    assert stage.trigger("reset").success
    assert stage.play(np.full(40, 1.0)).success


def test_emergency_stop_ends_tracking(stage):
    stage.answer = lambda block: 0.0
    assert stage.load(np.linspace(0, 60, 400)).success
    assert stage.start_tracking(feedback=True).success
    stage.until(lambda: stage.blocks and stage.blocks[-1].voltage_v[-1] == 60.0)
    assert stage.trigger("emergency_stop").success
    samples = stage.samples()
    assert samples.gapless
    assert samples.blocks[-1].flags == FLAG_STOPPED


def test_stop_tracking_ramps_to_rest_and_is_refused_when_nothing_tracks(stage):
    stage.answer = lambda block: 0.0
    assert stage.load(np.linspace(0, 60, 400)).success
    assert stage.start_tracking(feedback=True).success
    stage.until(lambda: stage.blocks and stage.blocks[-1].voltage_v[-1] == 60.0)
    with pytest.raises(GoalFailed, match=r"the stage is busy \(track, until it is stopped\)"):
        stage.play([1.0])
    assert stage.trigger("stop_tracking").success
    samples = stage.samples()
    assert samples.gapless
    assert len(samples.flagged(SampleBlock.FLAG_RAMPING)) == 1200
    response = stage.trigger("stop_tracking")
    assert not response.success
    assert response.message == "stop_tracking refused: the stage does not track (rest)"
