# SPDX-License-Identifier: BSD-3-Clause
"""The account of one run: what it answers to each block, and the error it reports."""

import pickle
import re

import numpy as np
import pytest

from piezo_controller.feedforward.periodic import FeedforwardPlan
from piezo_controller.tracking.tracking_run import NOT_FOLLOWED, AnswerTimes, TrackingRun
from piezo_studies.thesis.offline_loop import play_run

ONCE, PERIOD, RUN, BLOCK = 120, 60, 200, 40
ONCE_UM = np.linspace(0.0, 1.0, ONCE)
PERIOD_UM = 1.0 + np.sin(2 * np.pi * np.arange(PERIOD) / PERIOD)
EXPECTED_UM = np.r_[ONCE_UM, np.tile(PERIOD_UM, 5)]
PLAN = FeedforwardPlan(np.zeros(ONCE), np.zeros(PERIOD), ONCE_UM, PERIOD_UM, 80)


class Witness:
    """Feedback that answers with the mean error."""

    def step(self, expected_um, displacement_um):
        return float(np.mean(expected_um) - np.mean(displacement_um))


def play(run, displacement_um):
    """Return the answers of a run to a displacement, block by block."""
    return [run.take(block) for block in displacement_um.reshape(-1, BLOCK)]


def test_answer_is_to_the_error_of_the_very_block_once_feedback_begins():
    displacement_um = np.random.default_rng(1).normal(size=ONCE + RUN)
    error_um = EXPECTED_UM[:ONCE + RUN] - displacement_um
    expected = error_um.reshape(-1, BLOCK).mean(axis=1)
    expected[:2] = 0.0
    answers = play(TrackingRun(PLAN, RUN, Witness()), displacement_um)
    np.testing.assert_allclose(answers, expected, atol=1e-12)


def test_nothing_is_answered_without_feedback_or_after_the_end():
    assert play(TrackingRun(PLAN, RUN), np.ones(ONCE + RUN)) == [0.0] * 8
    run = TrackingRun(PLAN, RUN, Witness())
    assert play(run, np.ones(ONCE + RUN + BLOCK))[-1] == 0.0
    assert run.complete and run.fraction == 1.0


@pytest.mark.parametrize(("factor", "followed"), [
    (1.0, True), (0.3, True), (0.05, False), (0.0, False), (-1.0, False)])
def test_a_stage_that_moves_no_better_than_one_at_rest_is_told_of(factor, followed):
    displacement_um = EXPECTED_UM[:ONCE + RUN].copy()
    displacement_um[ONCE:] = 1.0 + factor * (displacement_um[ONCE:] - 1.0)
    run = TrackingRun(PLAN, RUN)
    play(run, displacement_um)
    assert run.not_followed.startswith(NOT_FOLLOWED) is not followed
    assert followed == (run.not_followed == "")


def test_a_reference_that_stands_still_is_never_told_of_as_not_followed():
    still = FeedforwardPlan(np.zeros(ONCE), np.zeros(PERIOD), np.ones(ONCE), np.ones(PERIOD), 80)
    run = TrackingRun(still, RUN)
    play(run, np.full(ONCE + RUN, 1.5))
    assert run.not_followed == ""


def test_error_is_that_of_the_periodic_part_alone():
    displacement_um = EXPECTED_UM[:ONCE + RUN].copy()
    displacement_um[:ONCE] += 100.0
    displacement_um[ONCE:] += 0.02
    run = TrackingRun(PLAN, RUN)
    play(run, displacement_um[:ONCE])
    assert np.isnan(run.e_rms_percent())
    play(run, displacement_um[ONCE:])
    assert run.e_rms_percent() == pytest.approx(100 * 0.02 / np.ptp(PERIOD_UM))
    assert run.largest_error_um == pytest.approx(0.02)


def test_running_error_is_that_of_the_last_samples():
    displacement_um = EXPECTED_UM[:ONCE + RUN].copy()
    displacement_um[-BLOCK:] += 0.02
    percent = 100 * 0.02 / np.ptp(PERIOD_UM)
    for blocks in (1, 2):
        run = TrackingRun(PLAN, RUN, window_samples=blocks * BLOCK)
        play(run, displacement_um)
        assert run.e_rms_percent(running=True) == pytest.approx(percent / np.sqrt(blocks))


def test_on_target_is_told_once_the_error_stays_within_the_tolerance():
    samples, bad = 2000, 600
    displacement_um = np.r_[ONCE_UM, np.resize(PERIOD_UM, samples)]
    displacement_um[ONCE:ONCE + bad] += 0.05
    run = TrackingRun(PLAN, samples, tolerance_um=0.02)
    told = []
    for block in displacement_um.reshape(-1, BLOCK):
        run.take(block)
        told.append(run.on_target)
    assert told == sorted(told)
    assert told[-1] and not told[(ONCE + bad) // BLOCK]
    # The rms over the window may keep 16 % of its samples 0.05 um away.
    assert bad - 0.16 * 400 - BLOCK <= run.settled_after_sample <= bad

    run.take(np.full(BLOCK, 60.0))
    assert run.complete
    late = TrackingRun(PLAN, samples, tolerance_um=0.02)
    displacement_um[-BLOCK:] += 1.0
    play(late, displacement_um)
    assert not late.on_target
    assert np.isnan(late.settled_after_sample)


def test_tolerance_is_a_part_of_the_travel_but_not_below_the_noise():
    assert TrackingRun(PLAN, RUN).tolerance_um == pytest.approx(0.03)
    wide = FeedforwardPlan(np.zeros(ONCE), np.zeros(PERIOD), ONCE_UM, 20 * PERIOD_UM, 80)
    assert TrackingRun(wide, RUN).tolerance_um == pytest.approx(0.2 * np.ptp(PERIOD_UM))


class Slow:
    """Feedback that takes its time, by the clock that it is."""

    def __init__(self, seconds):
        self._seconds = seconds
        self._now_s = 0.0

    def step(self, expected_um, displacement_um):
        self._now_s += self._seconds
        return 0.0

    def perf_counter(self):
        return self._now_s


@pytest.fixture
def slow(monkeypatch):
    def slow(seconds):
        feedback = Slow(seconds)
        monkeypatch.setattr("piezo_controller.tracking.tracking_run.time", feedback)
        return feedback

    return slow


def test_answers_that_take_longer_than_a_tick_are_told(slow):
    displacement_um = np.zeros(ONCE + RUN)
    late = TrackingRun(PLAN, RUN, slow(2e-3), tick_s=1e-3)
    play(late, displacement_um)
    assert re.search(r"6 of 6 answers .* the tick of 1000 us", late.lateness)
    in_time = TrackingRun(PLAN, RUN, slow(0.9e-3), tick_s=1e-3)
    play(in_time, displacement_um)
    assert in_time.lateness == ""


def test_open_loop_is_never_late():
    run = TrackingRun(PLAN, RUN, tick_s=1e-9)
    play(run, np.zeros(ONCE + RUN))
    assert run.lateness == ""


def test_played_run_answers_with_the_timing_of_the_stage():
    # Each block of displacement is its number; the answer to one acts two ticks later.
    blocks = iter(range(100))
    played = play_run(TrackingRun(PLAN, RUN, Witness()), PLAN,
                      lambda voltage_v: np.full(len(voltage_v), float(next(blocks))), BLOCK)
    answers = (EXPECTED_UM[:ONCE + RUN] - played.displacement_um).reshape(-1, BLOCK).mean(axis=1)
    answers[:2] = 0.0
    np.testing.assert_allclose(played.feedback_v.reshape(-1, BLOCK)[2:, 0], answers[:-2])
    np.testing.assert_allclose(played.voltage_v, played.feedback_v)


def test_times_of_any_number_of_answers_are_counted_and_their_percentile_told_to_12_percent():
    generator = np.random.default_rng(3)
    taken_s = 10.0 ** generator.uniform(-5, -2, 20_000)
    times = AnswerTimes(1e-3)
    for taken in taken_s:
        times.add(taken)
    assert (times.count, times.late) == (20_000, np.count_nonzero(taken_s > 1e-3))
    for percent in (50, 99):
        assert 1.0 <= times.percentile_s(percent) / np.percentile(taken_s, percent) < 1.13
    times.add(1e4)
    assert times.percentile_s(100) == np.inf


class CountingPlan:
    """A plan that knows its reference, and how much of it is asked for at once."""

    begin_sample, feedback_start_sample = 80, 80

    def __init__(self):
        self.largest = 0

    def expected_um(self, first, count):
        self.largest = max(self.largest, count)
        return np.sin(np.arange(first, first + count) / 500)

    def travel_um(self, samples):
        return 1.0


def kept_bytes(instance):
    """Return the bytes of an object and of all that it refers to, as pickle counts them."""
    return len(pickle.dumps(instance))


def test_run_of_an_hour_keeps_no_more_than_one_of_a_second():
    plan = CountingPlan()
    run = TrackingRun(plan, 3600 * 40_000, Witness(), window_samples=4000)
    sizes = []
    for _ in range(2):
        for _ in range(5000):
            run.take(np.zeros(BLOCK))
        sizes.append(kept_bytes(run))
    assert sizes[1] - sizes[0] < 1000
    assert plan.largest == BLOCK
    # The travel that was planned is corrected by what has been played.
    assert run.e_rms_percent() == pytest.approx(100 * np.sqrt(0.5) / 2.0, rel=1e-2)
