# SPDX-License-Identifier: BSD-3-Clause
"""The stage in wall-clock time: the same promises, but late answers are only counted."""

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from piezo_interfaces.msg import SampleBlock

from piezo_ros.quality import SAMPLES

IN_TICK = 400
"""Samples: ticks of 10 ms, ten times the usual ones, which a busy client keeps up with."""


@pytest.fixture(scope="module")
def paced_stage(nodes):
    return nodes.start(namespace="/paced", timing="paced", max_missed_feedback=10_000,
                       samples_per_tick=IN_TICK)


@pytest.fixture
def stage(paced_stage):
    paced_stage.forget()
    # What came while nobody looked is not to be mistaken for what comes now.
    paced_stage.until(lambda: len(paced_stage.blocks) > 0)
    paced_stage.play([0.0])
    paced_stage.forget()
    return paced_stage


def test_time_goes_on_gapless_at_rest(stage):
    stage.until(lambda: len(stage.blocks) >= 20)
    samples = stage.samples()
    assert samples.gapless
    assert not samples.voltage_v.any()


def test_waveform_is_played_exactly_as_uploaded(stage):
    waveform = 50 + 40 * np.sin(2 * np.pi * np.arange(4000) / 4000)
    result = stage.play(waveform, repeats=2)
    samples = stage.samples(result.last_sample)
    assert samples.gapless
    assert np.array_equal(samples.since(result.first_sample, 8000), np.tile(waveform, 2))


def test_missed_answers_are_counted(stage):
    assert stage.load([0.0]).success
    first_tick = stage.start_tracking(feedback=True, ticks=50).first_tick
    samples = stage.samples(IN_TICK * (first_tick + 50))
    assert samples.gapless
    tracked = [block for block in samples.blocks if block.flags & SampleBlock.FLAG_TRACKING]
    assert len(tracked) == 50
    # The first block to be answered is that of the second tick; it would act in the third.
    assert [block.missed_feedback for block in tracked] == [0, 0, *range(1, 49)]


def test_answers_act_or_are_counted_as_missed(stage):
    stage.answer = lambda block: 2.0
    assert stage.load([0.0]).success
    first_tick = stage.start_tracking(feedback=True).first_tick
    # A busy computer answers many ticks too late.
    stage.until_any(lambda block: block.tick > first_tick + 50 and block.voltage_v[-1] == 2.0)
    assert stage.trigger("stop_tracking").success
    stage.answer = None
    samples = stage.samples()
    held = len(samples.flagged(SampleBlock.FLAG_FEEDBACK_HELD))
    assert held == IN_TICK * max(block.missed_feedback for block in samples.blocks)
    assert samples.flagged(SampleBlock.FLAG_TRACKING).max() == 2.0


def test_fast_branch_is_as_uploaded_whatever_becomes_of_the_answers(stage):
    period_v = 50 - 50 * np.cos(2 * np.pi * np.arange(400) / 400)
    stage.until(lambda: stage.blocks)
    begin = stage.blocks[-1].tick

    def answer(block):
        """Some answers are late by a tick or more, some never come."""
        return 1e-6 * (block.tick - begin) if block.tick % 7 else None

    stage.answer = answer
    assert stage.load([], period_v).success
    first_tick = stage.start_tracking(feedback=True, ticks=100).first_tick
    samples = stage.samples(IN_TICK * (first_tick + 100))
    stage.answer = None
    assert samples.gapless
    tracked = [block for block in samples.blocks if block.flags & SampleBlock.FLAG_TRACKING]
    assert len(tracked) == 100
    ticks = np.array([block.tick - 1 for block in tracked])
    voltage_v = np.array([block.voltage_v for block in tracked])
    held = np.array([block.flags & SampleBlock.FLAG_FEEDBACK_HELD > 0 for block in tracked])
    answered = np.where(ticks - first_tick < 2, 0, np.where(held, 0, ticks - 1 - begin))
    feedback_v = 1e-6 * np.maximum.accumulate(answered)
    assert np.array_equal(voltage_v, np.resize(period_v, (100, IN_TICK)) + feedback_v[:, None])
    assert tracked[-1].missed_feedback == held.sum() >= 100 // 7 - 1


def test_diagnostics_hold_the_histograms_of_the_answers_and_of_the_ticks(stage):
    values = {}

    def hear(array):
        for status in array.status:
            if status.name == "/paced/stage: stage":
                values.update({value.key: value.value for value in status.values})

    def counts(what):
        return [int(value) for key, value in values.items() if key.startswith(what)]

    stage.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
    stage.until(lambda: values)
    before = sum(counts("answers_"))
    stage.answer = lambda block: 0.0
    assert stage.load([0.0]).success
    first_tick = stage.start_tracking(feedback=True, ticks=100).first_tick
    # The last answers may come after the run.
    stage.until(lambda: sum(counts("answers_")) >= before + 90)
    stage.answer = None
    assert len(counts("answers_")) == 10
    assert float(values["longest_answer_ms"]) > 0.0
    stage.until(lambda: sum(counts("ticks_")) >= first_tick + 99)
    assert int(values["missed_deadlines"]) <= sum(counts("ticks_"))
    assert "granted" in values["real_time"] or "is not" in values["real_time"]


def test_waveform_of_one_value_per_second_can_be_cancelled_before_it_fills_a_block(stage):
    stage.until(lambda: len(stage.blocks) > 0)
    before = stage.blocks[-1].first_sample
    told = []
    goal = stage.send_goal("play_waveform", on_feedback=told.append, voltage_v=np.full(100, 10.0),
                           sample_period_s=1.0, repeats=1)
    stage.until(lambda: any(feedback.stage == "play" for feedback in told))
    status, result = stage.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED
    assert result.last_sample - before < 20 * 40_000  # a block has 40 s
    # The last value that was played is a mean over the way to rest.
    samples = stage.samples(result.last_sample + 1)
    assert samples.gapless
    assert samples.voltage_v[-1] == 0.0


def test_ground_truth_has_no_wrong_samples_around_a_slow_waveform(stage):
    truth = []
    subscription = stage.node.create_subscription(
        SampleBlock, "ground_truth", truth.append, SAMPLES)
    stage.until(lambda: truth)
    result = stage.play(np.full(100, 10.0), sample_period_s=0.001)
    end = result.last_sample + 1 + 20 * IN_TICK  # twenty blocks at rest after the waveform
    samples = stage.samples(end)
    stage.until(lambda: truth[-1].first_sample > end)
    stage.node.destroy_subscription(subscription)
    measured_um = {block.first_sample: block.displacement_um for block in samples.blocks
                   if block.sample_period_s == 25e-6}
    within = range(samples.first_sample, samples.blocks[-1].first_sample)
    true_um = {message.first_sample + at: message.displacement_um[at:at + IN_TICK]
               for message in truth for at in range(0, len(message.displacement_um), IN_TICK)
               if message.first_sample + at in within}
    assert len(true_um) > 10
    assert true_um.keys() <= measured_um.keys()
    for first_sample, block_um in true_um.items():
        # The sensor has a noise of 0.009 um RMS, and steps of 0.004 um.
        assert np.abs(np.subtract(block_um, measured_um[first_sample])).max() < 0.1
