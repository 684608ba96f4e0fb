# SPDX-License-Identifier: BSD-3-Clause
"""The law that a stage evaluates, beside the feedback that answers its blocks."""

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.signal import lfilter

from piezo_controller.feedback.feedback_before_inverse import FeedbackBeforeInverse
from piezo_controller.feedback.feedback_design import FeedbackController, design_feedback
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.onboard_law import FADE_S, onboard_law
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.feedforward.periodic import plan_feedforward
from piezo_controller.references.reference import Reference, sample_reference
from piezo_controller.tracking.tracking_run import TrackingRun
from piezo_models.feedback_law.feedback_law import FeedbackLawError
from piezo_models.feedback_law.law_check import check_law
from piezo_models.feedback_law.running_law import RunningLaw
from piezo_studies.thesis.offline_loop import play_run

SAMPLES, CLOCK_PERIOD_S, MAX_FEEDBACK_V = 40, 25e-6, 20.0
TICKS = 400


@pytest.fixture(scope="module")
def plan(stage_model):
    reference_um = sample_reference(Reference("harmonic", (100.0,), (40.0,), (), 50.0))
    return plan_feedforward(reference_um, stage_model, duration_s=0.2)


@pytest.fixture(scope="module")
def quick_controller(stage_model, controller, short_search):
    """Return the default design for a stage that evaluates it without computing time."""
    return design_feedback(stage_model, load_weights(), delay_ticks=0)


def evaluated(law, plan, exchange, ticks, samples=SAMPLES):
    """Play a plan with a law; return the feedback (V), shape (ticks, samples), and displacement."""
    running = RunningLaw(law, samples)
    feedback_v, displacement_um = np.empty((2, ticks, samples))
    for tick in range(ticks):
        planned_v = plan.voltage_v(tick * samples, samples)
        feedback_v[tick] = running.begin(planned_v)
        displacement_um[tick] = exchange(planned_v + feedback_v[tick])
        running.take(displacement_um[tick])
    return feedback_v, displacement_um


def answered(feedback, plan, exchange):
    """Play a plan with answers to its blocks, as `play_run` does."""
    run = TrackingRun(plan, (TICKS + 2) * SAMPLES, feedback, fade_s=FADE_S)
    return play_run(run, plan, exchange, SAMPLES)


@pytest.mark.parametrize("before_inverse", [False, True])
@pytest.mark.parametrize("limit_v", [MAX_FEEDBACK_V, 0.4])
def test_law_gives_what_the_feedback_answers(stage_model, controller, plan, exchange_with,
                                             before_inverse, limit_v):
    feedback = MultirateFeedback(controller, limit_v)
    if before_inverse:
        feedback = FeedbackBeforeInverse(controller, stage_model, plan, SAMPLES, limit_v)
    remote = answered(feedback, plan, exchange_with(stage_model, 1.5))
    law = onboard_law(controller, stage_model, plan, CLOCK_PERIOD_S, limit_v, before_inverse,
                      hold_inverse=True)
    ticks = len(remote.feedback_v) // SAMPLES
    feedback_v, displacement_um = evaluated(
        law, plan, exchange_with(stage_model, 1.5), ticks)
    assert np.abs(remote.feedback_v).max() > 0.3
    np.testing.assert_allclose(feedback_v.ravel(), remote.feedback_v, atol=1e-9)
    np.testing.assert_allclose(displacement_um.ravel(), remote.displacement_um, atol=1e-9)


def test_design_without_computing_time_tracks_better(stage_model, controller, quick_controller,
                                                     plan, exchange_with):
    """Both begin with the same offset and the same noise, on the stage they were designed for."""
    left_um = {}
    for found in (controller, quick_controller):
        law = onboard_law(found, stage_model, plan, CLOCK_PERIOD_S, MAX_FEEDBACK_V)
        check_law(law, SAMPLES)
        _, displacement_um = evaluated(law, plan, exchange_with(stage_model, 2.0), TICKS)
        first = law.start_sample // SAMPLES
        error_um = plan.expected_um(0, TICKS * SAMPLES).reshape(TICKS, SAMPLES) - displacement_um
        left_um[found.delay_ticks] = np.sqrt(np.mean(error_um[first:] ** 2))
    assert left_um[0] < 0.97 * left_um[1]
    bandwidth_hz = [found.report["bandwidth_hz"] for found in (quick_controller, controller)]
    assert bandwidth_hz[0] > bandwidth_hz[1]


@pytest.mark.parametrize("factor", [12.0, 60.0, 300.0])
@pytest.mark.parametrize("before_inverse", [False, True])
def test_law_of_a_gain_many_times_too_high_is_refused(stage_model, quick_controller, plan, factor,
                                                      before_inverse):
    law = onboard_law(quick_controller, stage_model, plan, CLOCK_PERIOD_S, MAX_FEEDBACK_V,
                      before_inverse)
    check_law(law, SAMPLES)
    loud = replace(law, tick=replace(law.tick, c=factor * law.tick.c, d=factor * law.tick.d))
    with pytest.raises(FeedbackLawError, match="not stable with the declared model"):
        check_law(loud, SAMPLES)


@pytest.mark.parametrize("delay_ticks", [0, 1])
def test_law_of_samples_comes_as_many_samples_later_as_its_controller_declares(
        stage_model, plan, delay_ticks):
    """Beside the difference equation of the controller, simulated by SciPy."""
    numerator, denominator = [0.02, 0.013, -0.004], [1.0, -1.3, 0.42]
    system = control.ss(control.tf(numerator, denominator, CLOCK_PERIOD_S))
    controller = FeedbackController(system.A, system.B, system.C, system.D, CLOCK_PERIOD_S,
                                    {"delay_ticks": delay_ticks}, {})
    law = replace(onboard_law(controller, stage_model, plan, CLOCK_PERIOD_S, 1e3), fade_samples=0)
    assert law.delay_ticks == 0 and law.tick.empty
    displacement_um = 0.3 * np.random.default_rng(3).normal(size=TICKS * SAMPLES)
    running, fed_back_v = RunningLaw(law, SAMPLES), np.empty(len(displacement_um))
    for sample, measured_um in enumerate(displacement_um):
        fed_back_v[sample] = running.begin(np.zeros(1))[0]
        running.take(np.array([measured_um]))
    start = -(-law.start_sample // SAMPLES) * SAMPLES
    error_um = plan.expected_um(0, len(displacement_um)) - displacement_um
    answers_v = lfilter(numerator, denominator, error_um[start:])
    # What a sample measures acts in the next one at the earliest.
    late = start + 1 + delay_ticks
    assert not fed_back_v[:late].any() and fed_back_v[late] != 0.0
    np.testing.assert_allclose(fed_back_v[late:], answers_v[:len(fed_back_v) - late], atol=1e-9)
