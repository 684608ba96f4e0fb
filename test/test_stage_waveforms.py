# SPDX-License-Identifier: BSD-3-Clause
"""Waveforms are played as uploaded, or refused before anything moves."""

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Time
from piezo_interfaces.action import PlayWaveform
from piezo_interfaces.msg import SampleBlock

from piezo_client.client import GoalFailed

FLAG_PLAYING, FLAG_RAMPING = SampleBlock.FLAG_PLAYING, SampleBlock.FLAG_RAMPING


def sine(samples=400, centre_v=50.0, amplitude_v=30.0):
    return centre_v + amplitude_v * np.sin(2 * np.pi * np.arange(samples) / samples)


def test_waveform_is_published_gapless_and_exactly_as_uploaded(suite):
    waveform = sine()
    result = suite.play(waveform, repeats=3)
    assert result.samples == 1200
    samples = suite.samples(result.last_sample)
    assert samples.gapless
    lengths = [len(block.voltage_v) for block in samples.blocks]
    assert max(lengths) == 200 and all(length % 40 == 0 for length in lengths)
    assert lengths == [len(block.displacement_um) for block in samples.blocks]
    assert all(block.sample_period_s == 25e-6 for block in samples.blocks)
    assert all(40 * block.tick == block.first_sample + len(block.voltage_v)
               for block in samples.blocks)
    assert np.array_equal(samples.since(result.first_sample, 1200), np.tile(waveform, 3))
    assert np.array_equal(samples.flagged(FLAG_PLAYING), np.tile(waveform, 3))
    assert samples.blocks[-1].first_sample + lengths[-1] - 1 == result.last_sample


def test_ramps_lead_from_rest_and_back_at_their_rate(suite):
    samples = suite.samples(suite.play(np.full(80, 60.0)).last_sample)
    ramps = samples.flagged(FLAG_RAMPING)
    assert len(ramps) == 2 * 1200  # 60 V at 2000 V/s
    assert np.allclose(np.abs(np.diff(ramps[:1200])), 0.05)
    assert samples.voltage_v[-40:].any() == 0


def test_slow_waveform_is_published_sample_by_sample_as_uploaded(suite):
    waveform = sine(1000)
    result = suite.play(waveform, sample_period_s=0.001)
    assert result.samples == 40_000
    samples = suite.samples(result.last_sample)
    assert samples.gapless
    assert {block.sample_period_s for block in samples.blocks[:-1]} == {0.001}
    # Each published voltage is the mean over the held one.
    assert np.allclose(samples.flagged(FLAG_PLAYING), waveform, rtol=1e-13, atol=0)


def test_waveform_may_hold_at_its_end_and_another_goes_on_from_there(suite):
    suite.play(np.full(40, 20.0), hold_at_end=True)
    suite.samples(suite.play(np.full(40, 20.0), hold_at_end=True).last_sample)
    suite.forget()
    samples = suite.samples(suite.play(np.full(40, 20.0)).last_sample)
    assert samples.voltage_v[0] == 20.0
    assert samples.voltage_v[-1] == 0.0


@pytest.mark.parametrize(("fields", "sentence"), [
    ({"voltage_v": [1.0, np.nan]}, "voltage sample 1 is not a finite number"),
    ({"voltage_v": [1.0, np.inf]}, "voltage sample 1 is not a finite number"),
    ({"voltage_v": [0.0, 120.5]}, r"voltage sample 1 is 120.5 V, outside \[-20, 120\] V"),
    ({"voltage_v": [-21.0]}, r"voltage sample 0 is -21 V, outside \[-20, 120\] V"),
    ({"voltage_v": [0.0, 60.0]}, "jumps by 60 V to sample 1, more than the 50 V"),
    ({"voltage_v": [0.0, 30.0, 60.0], "repeats": 2}, "jumps by 60 V"),
    ({"voltage_v": []}, "the voltage sequence is empty"),
    ({"voltage_v": [1.0], "repeats": 0}, "repeats is 0"),
    ({"voltage_v": [1.0], "sample_period_s": 0.0}, "the sample period 0 s is not within"),
    ({"voltage_v": [1.0], "sample_period_s": np.nan}, "the sample period nan s is not within"),
    ({"voltage_v": [1.0], "sample_period_s": 2.0}, "the sample period 2 s is not within"),
    ({"voltage_v": [1.0], "sample_period_s": 60e-6}, "no whole multiple of the clock period"),
])
def test_impossible_waveform_is_refused_in_one_sentence_and_nothing_moves(suite, fields, sentence):
    before = suite.play([0.0]).last_sample
    with pytest.raises(GoalFailed, match=sentence) as failure:
        suite.play(**fields)
    assert failure.value.result.message.startswith("waveform refused: ")
    assert "\n" not in failure.value.result.message
    # Stage time passes only while something plays.
    assert suite.play([0.0]).first_sample == before + 1


def test_second_waveform_is_refused_while_one_plays_and_the_first_goes_on(suite):
    waveform = sine(4000)
    goal = suite.begin_play(waveform, repeats=1_000_000)  # however fast the machine is
    with pytest.raises(GoalFailed, match="the stage is busy"):
        suite.play([1.0])
    refused_at = len(suite.blocks)
    suite.until(lambda: len(suite.blocks) > refused_at + 200)
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED
    samples = suite.samples(result.last_sample)
    assert samples.gapless
    played = samples.flagged(FLAG_PLAYING)
    assert len(played) > 200 * 40
    assert np.array_equal(played, np.tile(waveform, len(played) // 4000 + 1)[:len(played)])


def test_waveform_that_was_given_up_never_plays(suite):
    late = suite.wait(suite._actions["play_waveform"].send_goal_async(PlayWaveform.Goal(
        voltage_v=[1.0], sample_period_s=25e-6, repeats=1, deadline=Time(sec=1))))
    assert not late.accepted
    suite.play([0.0])
    assert not np.any(suite.samples().voltage_v)


@pytest.mark.parametrize("sample_period_s", [25e-6, 1.0])
def test_cancelled_waveform_ramps_to_rest(suite, sample_period_s):
    goal = suite.begin_play(np.full(4000, 60.0), sample_period_s, repeats=4_000_000)
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED
    assert not result.success
    assert "cancelled" in result.message
    samples = suite.samples(result.last_sample)
    assert samples.gapless
    assert np.abs(np.diff(samples.flagged(FLAG_RAMPING))).max() < 60.0
    assert samples.voltage_v[-1] == 0.0
    assert len(samples.flagged(FLAG_PLAYING)) < 4000 * 4_000_000


def test_waveform_cancelled_at_once_ramps_to_rest_from_its_approach(suite):
    goal = suite.send_goal("play_waveform", voltage_v=[120.0] * 4000, sample_period_s=25e-6,
                           repeats=1_000_000)
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED
    samples = suite.samples(result.last_sample)
    assert samples.gapless
    assert np.abs(np.diff(samples.voltage_v)).max() < 0.051  # 2000 V/s
    assert samples.voltage_v[-1] == 0.0


def test_feedback_tells_stage_fraction_and_time_left(suite):
    told = []
    result = suite.play(sine(), on_feedback=told.append)  # over at once: each phase is told
    stages = [feedback.stage for feedback in told]
    assert list(dict.fromkeys(stages)) == ["approach", "play", "return"]
    fractions = [feedback.fraction for feedback in told]
    assert 0.0 <= fractions[0] < fractions[-1] <= 1.0
    assert fractions == sorted(fractions)
    total_s = 25e-6 * result.last_sample
    assert all(0.0 <= feedback.seconds_left <= total_s for feedback in told)
    suite.samples(result.last_sample)


# Both ends keep 5000 blocks each, of 200 samples: less does not hold the stage back.
@pytest.mark.parametrize(("blocks", "held_back"), [
    (2_400, False), pytest.param(12_000, True, marks=pytest.mark.long)])
def test_subscriber_that_does_not_read_holds_the_stage_back_until_it_is_gone(
        suite, blocks, held_back):
    def goes_on():
        seen = len(suite.blocks)
        return suite.spin_until(lambda: len(suite.blocks) > seen, 1.0)

    with suite.another_client() as other:
        other.connect()
        # From here on it never looks at what comes.
        goal = suite.begin_play(np.full(4000, 60.0), repeats=blocks // 20)
        while goes_on():
            pass
        if held_back:
            assert not goal.outcome.done()
            assert 10_000 <= len(suite.blocks) < blocks
    _, result = suite.result(goal)
    assert result.success, result.message
    samples = suite.samples(result.last_sample)
    assert samples.gapless
    count = blocks * 200
    assert np.array_equal(samples.since(result.first_sample, count), np.full(count, 60.0))
