# SPDX-License-Identifier: BSD-3-Clause
"""The account of one run: what it answers to each block, and the error it reports."""

import numpy as np
import pytest

from piezo_controller.feedforward import FeedforwardPlan
from piezo_controller.tracking_run import TrackingRun

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
    """Answers of a run to a displacement, block by block."""
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
    run = TrackingRun(PLAN, RUN)
    play(run, displacement_um)
    percent = 100 * 0.02 / np.ptp(PERIOD_UM)
    assert run.e_rms_percent(BLOCK) == pytest.approx(percent)
    assert run.e_rms_percent(2 * BLOCK) == pytest.approx(percent / np.sqrt(2))
