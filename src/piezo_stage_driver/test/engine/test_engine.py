# SPDX-License-Identifier: BSD-3-Clause
"""The stage engine against a backend that echoes what it is given."""

import sys
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from linear_stage_loop import finish

from piezo_stage_driver.engine.blocks import (
    FLAG_FEEDBACK_HELD,
    FLAG_FEEDFORWARD_HELD,
    FLAG_PLAYING,
    FLAG_RAMPING,
    FLAG_STOPPED,
    FLAG_TRACKING,
)
from piezo_stage_driver.engine.feedback_hold import FeedbackError
from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.guards import StopLatch
from piezo_stage_driver.safety.limits import (
    FLAG_RANGE_LIMITED,
    FLAG_SLEW_LIMITED,
    LimitError,
    VoltageLimits,
)

PERIOD_S = 1 / 40000.0


class EchoBackend:
    """Measures twice the voltage, and remembers everything it was given."""

    sample_rate_hz = 40000.0

    def __init__(self):
        self.played_v = np.empty(0)

    def exchange(self, voltage_v):
        self.played_v = np.r_[self.played_v, voltage_v]
        return 2.0 * voltage_v


def make_engine(**options):
    backend = EchoBackend()
    return StageEngine(backend, VoltageLimits(-20.0, 120.0, 2.0e6), **options), backend


def joined(blocks, name):
    return np.concatenate([getattr(block, name) for block in blocks if block is not None])


def assert_every_sample_accounted_for(blocks, decimation=1):
    at = blocks[0].first_sample if blocks[0] else 0
    for block in (block for block in blocks if block is not None):
        assert block.first_sample == at
        at += len(block.voltage_v) * decimation


def test_waveform_is_played_sample_by_sample_between_two_ramps():
    engine, backend = make_engine()
    waveform = 30.0 + 5.0 * np.sin(np.arange(400) * 0.1)
    first, count = engine.commands.play(waveform, PERIOD_S, repeats=2)
    blocks = finish(engine)
    assert count == 800
    assert np.array_equal(backend.played_v[first:first + 800], np.tile(waveform, 2))
    assert backend.played_v[-1] == 0.0
    assert np.abs(np.diff(backend.played_v, prepend=0.0)).max() < 5.0
    assert_every_sample_accounted_for(blocks)
    playing = [block for block in blocks if block.flags & FLAG_PLAYING]
    assert np.array_equal(joined(playing, "voltage_v"), np.tile(waveform, 2))
    assert all(len(block.voltage_v) == 40 for block in blocks)
    assert blocks[0].flags == FLAG_RAMPING and blocks[-1].flags == FLAG_RAMPING


def test_blocks_of_a_waveform_that_nobody_answers_hold_the_samples_of_many_ticks():
    voltage_v = 50.0 - 30.0 * np.cos(2.0 * np.pi * np.arange(9001) / 400.0)
    played = []
    for longest, options in (
            (40, {}), (200, {"samples_per_block": 800}),
            (40, {"samples_per_block": 800, "longest_stretch_samples": 40})):
        engine, backend = make_engine(**options)
        engine.commands.play(voltage_v, PERIOD_S)
        blocks = finish(engine)
        assert_every_sample_accounted_for(blocks)
        assert max(block.voltage_v.size for block in blocks) == longest
        flags = np.concatenate([np.full(block.voltage_v.size, block.flags) for block in blocks])
        played.append((backend.played_v, joined(blocks, "displacement_um"), flags))
    for other in played[1:]:
        for one, values in zip(played[0], other, strict=True):
            np.testing.assert_array_equal(one, values)


@pytest.mark.parametrize("decimation", [3, 40, 400])
def test_slow_waveform_is_published_as_means_over_its_samples(decimation):
    engine, backend = make_engine()
    waveform = np.linspace(10.0, 60.0, 97)
    first, count = engine.commands.play(waveform, decimation * PERIOD_S)
    blocks = finish(engine)
    assert np.array_equal(backend.played_v[first:first + count], np.repeat(waveform, decimation))
    means = backend.played_v.reshape(-1, decimation).mean(axis=1)
    assert np.allclose(joined(blocks, "voltage_v"), means, rtol=0, atol=1e-12)
    assert np.allclose(joined(blocks, "displacement_um"), 2 * means, rtol=0, atol=1e-12)
    assert_every_sample_accounted_for([block for block in blocks if block], decimation)


@settings(max_examples=40, deadline=None)
@given(decimation=st.sampled_from([1, 2, 7, 40, 100]), cancel_after=st.integers(0, 40),
       chunk=st.sampled_from([40, 400, 16000]))
def test_cancelled_waveform_ramps_to_rest_and_loses_no_sample(decimation, cancel_after, chunk):
    engine, backend = make_engine(longest_stretch_samples=chunk)
    engine.commands.play(np.full(500, 80.0), decimation * PERIOD_S)
    blocks = [engine.advance() for _ in range(cancel_after) if not engine.idle]
    engine.return_to_rest()
    blocks += finish(engine)
    assert backend.played_v.size == 0 or backend.played_v[-1] == 0.0
    assert np.abs(np.diff(backend.played_v, prepend=0.0)).max(initial=0) <= 2000 * PERIOD_S + 1e-9
    if backend.played_v.size:
        means = backend.played_v.reshape(-1, decimation).mean(axis=1)
        assert np.allclose(joined(blocks, "voltage_v"), means, rtol=0, atol=1e-9)
    engine.commands.play([1.0], PERIOD_S)


@pytest.mark.parametrize("voltage_v, period_s, repeats, word", [
    ([0.0, np.nan], PERIOD_S, 1, "sample 1 is not a finite number"),
    ([0.0, np.inf], PERIOD_S, 1, "sample 1 is not a finite number"),
    ([0.0, 121.0], PERIOD_S, 1, "outside"),
    ([0.0, 60.0], PERIOD_S, 1, "jumps"),
    ([0.0, 40.0, 60.0], PERIOD_S, 2, "jumps"),
    ([], PERIOD_S, 1, "empty"),
    ([1.0], PERIOD_S, 0, "repeats"),
    ([1.0], 1.7 * PERIOD_S, 1, "whole multiple"),
    ([1.0], 0.5 * PERIOD_S, 1, "sample period"),
    ([1.0], 2.0, 1, "sample period"),
    ([1.0], np.nan, 1, "sample period"),
])
def test_bad_waveform_is_refused_and_moves_nothing(voltage_v, period_s, repeats, word):
    engine, backend = make_engine()
    with pytest.raises(ValueError, match=word):
        engine.commands.play(voltage_v, period_s, repeats)
    assert engine.idle and backend.played_v.size == 0


def test_second_command_is_refused_while_one_plays():
    engine, _ = make_engine()
    engine.commands.play(np.full(100, 5.0), PERIOD_S)
    with pytest.raises(StageRefusal, match="busy"):
        engine.commands.play([1.0], PERIOD_S)
    with pytest.raises(StageRefusal, match="busy"):
        engine.commands.load_feedforward([0.0], [])


@pytest.mark.parametrize("samples_per_tick", [1, 40])
def test_feedback_computed_from_a_tick_acts_one_tick_after_it_could_be_answered(samples_per_tick):
    engine, backend = make_engine(samples_per_tick=samples_per_tick)
    engine.commands.load_feedforward(np.zeros(40), np.zeros(40))
    first_tick = engine.commands.start_tracking(feedback=True, ticks=10)
    answered = {}
    while engine.phase_name == "track":
        assert not engine.awaiting_answer
        block = engine.advance()
        if block.tick > first_tick:
            answered[block.tick] = 0.01 * block.tick
            engine.answer(block.tick, answered[block.tick])
    ticks = backend.played_v[:10 * samples_per_tick].reshape(-1, samples_per_tick)
    assert np.all(ticks[:2] == 0.0)
    for tick in range(first_tick + 2, first_tick + 10):
        assert np.all(ticks[tick] == answered[tick - 1])


def test_late_answer_holds_the_last_value_and_is_counted():
    engine, backend = make_engine()
    engine.commands.load_feedforward([], np.zeros(40))
    engine.commands.start_tracking(feedback=True)
    engine.advance()
    engine.answer(1, 0.5)
    engine.advance()
    held = [engine.advance(), engine.advance()]
    assert held[0].flags & FLAG_FEEDBACK_HELD == 0 and held[0].missed_feedback == 0
    assert held[1].flags & FLAG_FEEDBACK_HELD and held[1].missed_feedback == 1
    assert np.all(held[1].voltage_v == 0.5)
    assert engine.awaiting_answer


def test_watchdog_stops_the_stage_when_answers_stay_away():
    engine, backend = make_engine(max_missed_feedback=3)
    engine.commands.load_feedforward(np.full(40, 10.0) * np.linspace(0, 1, 40), [])
    engine.commands.start_tracking(feedback=True)
    blocks = finish(engine)
    assert "missed" in engine.stop_cause
    assert backend.played_v[-1] == 0.0
    assert blocks[-1].flags & FLAG_STOPPED
    with pytest.raises(StageRefusal, match="reset"):
        engine.commands.play([1.0], PERIOD_S)
    engine.commands.reset()
    engine.commands.play([1.0], PERIOD_S)


def test_feedback_that_is_no_number_is_refused():
    engine, _ = make_engine()
    engine.commands.load_feedforward([], np.zeros(40))
    engine.commands.start_tracking(feedback=True)
    engine.advance()
    with pytest.raises(FeedbackError, match="not a finite"):
        engine.answer(1, float("nan"))


def test_sum_of_feedforward_and_feedback_stays_within_range_and_slew():
    engine, backend = make_engine()
    engine.commands.load_feedforward([], np.zeros(40))
    engine.commands.start_tracking(feedback=True)
    engine.advance()
    engine.answer(1, 200.0)
    engine.advance()
    block = engine.advance()
    assert block.flags & FLAG_RANGE_LIMITED and block.flags & FLAG_SLEW_LIMITED
    assert block.voltage_v.max() == 120.0
    assert np.diff(block.voltage_v, prepend=0.0).max() <= 50.0 * (1 + 1e-6)


def test_feedforward_is_played_exactly_once_then_repeated():
    engine, backend = make_engine()
    once, period = np.linspace(0, 3, 57), 3.0 + np.sin(np.arange(33))
    engine.commands.load_feedforward(once, period)
    engine.commands.start_tracking(feedback=False, ticks=5)
    blocks = finish(engine)
    expected = np.r_[once, np.tile(period, 10)][:200]
    assert np.array_equal(backend.played_v[:200], expected)
    assert all(block.flags & FLAG_TRACKING for block in blocks[:5])


def test_streamed_feedforward_grows_while_it_plays_and_holds_when_it_runs_dry():
    engine, backend = make_engine()
    engine.commands.load_feedforward(np.linspace(0, 1, 40), [])
    engine.commands.start_tracking(feedback=False)
    engine.advance()
    engine.commands.load_feedforward(np.linspace(1, 2, 40), [], append=True)
    engine.advance()
    dry = engine.advance()
    assert np.array_equal(backend.played_v[40:80], np.linspace(1, 2, 40))
    assert np.all(dry.voltage_v == 2.0) and dry.flags & FLAG_FEEDFORWARD_HELD
    with pytest.raises(LimitError, match="jumps"):
        engine.commands.load_feedforward([100.0], [], append=True)


def test_feedforward_that_would_jump_is_refused():
    engine, _ = make_engine()
    engine.commands.load_feedforward(np.full(40, 60.0), [])
    with pytest.raises(LimitError, match="jumps"):
        engine.commands.start_tracking(feedback=False)
    assert engine.idle


def test_emergency_stop_ramps_to_rest_and_stays_latched_until_reset():
    engine, backend = make_engine()
    engine.commands.play(np.full(4000, 100.0), PERIOD_S)
    for _ in range(80):
        engine.advance()
    engine.stop("pressed")
    with pytest.raises(StageRefusal, match="returns to rest"):
        engine.commands.reset()
    finish(engine)
    assert backend.played_v[-1] == 0.0
    assert np.abs(np.diff(backend.played_v)).max() <= 2000 * PERIOD_S + 1e-9
    with pytest.raises(StageRefusal, match="pressed"):
        engine.commands.start_tracking(False)


class LatchSetWhileItIsRead(StopLatch):
    """Another thread stops the stage right after the n-th look at the cause."""

    def __init__(self, looks):
        super().__init__()
        self._looks = looks

    @property
    def cause(self):
        self._looks -= 1
        return "pressed" if self._looks < 0 else ""

    @cause.setter
    def cause(self, cause):
        pass


@pytest.mark.parametrize("looks", range(8))
def test_every_block_of_a_stopped_stage_ramps_whenever_the_stop_came(looks):
    latch = LatchSetWhileItIsRead(10**6)
    engine, _ = make_engine(latch=latch)
    engine.commands.play(np.full(4000, 60.0), PERIOD_S)
    for _ in range(40):
        engine.advance()
    latch._looks = looks
    blocks = finish(engine)
    stopped_v = joined([block for block in blocks if block.flags & FLAG_STOPPED], "voltage_v")
    assert stopped_v[0] < 60.0
    assert np.allclose(np.diff(stopped_v[:1200]), -2000 * PERIOD_S)


def test_held_voltage_is_where_the_next_waveform_begins():
    engine, backend = make_engine()
    engine.commands.play([7.0], PERIOD_S, hold_at_end=True)
    finish(engine)
    assert engine.voltage_v == 7.0
    engine.commands.play([9.0], PERIOD_S)
    finish(engine)
    assert np.abs(np.diff(backend.played_v, prepend=0.0)).max() <= 2000 * PERIOD_S + 1e-9


def test_empty_range_is_refused():
    with pytest.raises(LimitError, match="empty"):
        VoltageLimits(1.0, 1.0, 1.0)


class LeadBackend(EchoBackend):
    """Applies what it is given two ticks later."""

    lead_samples = 80

    def __init__(self):
        super().__init__()
        self.applied_v = np.zeros(80)

    def exchange(self, voltage_v):
        self.applied_v = np.r_[self.applied_v, voltage_v]
        measured_um = 2.0 * self.applied_v[len(self.played_v):len(self.played_v) + len(voltage_v)]
        super().exchange(voltage_v)
        return measured_um


def test_hardware_that_is_written_ahead_is_published_with_the_voltage_it_applied():
    backend = LeadBackend()
    engine = StageEngine(backend, VoltageLimits(-20.0, 120.0, 2.0e6))
    waveform = 30.0 + 5.0 * np.sin(np.arange(400) * 0.1)
    first, count = engine.commands.play(waveform, PERIOD_S)
    blocks = finish(engine)
    last_sample = engine.last_sample
    blocks += [engine.advance(), engine.advance()]
    assert blocks[-1].first_sample + 39 == last_sample
    voltage_v, displacement_um = (joined(blocks, name) for name in ("voltage_v", "displacement_um"))
    assert np.array_equal(displacement_um, 2.0 * voltage_v)
    assert np.array_equal(voltage_v[first:first + count], waveform)
    playing = [block for block in blocks if block.flags & FLAG_PLAYING]
    assert np.array_equal(joined(playing, "voltage_v"), waveform)
    assert_every_sample_accounted_for(blocks)


def test_answers_to_hardware_that_is_written_ahead_are_awaited_as_much_later():
    engine = StageEngine(LeadBackend(), VoltageLimits(-20.0, 120.0, 2.0e6))
    engine.commands.load_feedforward([], np.zeros(40))
    engine.commands.start_tracking(feedback=True)
    ticks = []
    for _ in range(6):
        block = engine.advance()
        if block.flags & FLAG_TRACKING:
            engine.answer(block.tick, 1.0)
            ticks.append(block.tick)
    assert ticks == [3, 4, 5, 6]
    assert engine.missed_feedback == 0


def test_rest_can_be_asked_for_while_the_loop_runs():
    backend = EchoBackend()
    backend.lead_samples = 320
    engine = StageEngine(backend, VoltageLimits(-20.0, 120.0, 2.0e6))
    loop = threading.Thread(target=lambda: [engine.advance() for _ in range(1000)])
    usual_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        loop.start()
        asked = [engine.at_rest]
        while loop.is_alive():
            asked.append(engine.at_rest)
    finally:
        sys.setswitchinterval(usual_s)
        loop.join()
    assert all(asked)
