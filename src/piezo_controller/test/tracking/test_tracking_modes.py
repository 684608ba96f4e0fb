# SPDX-License-Identifier: BSD-3-Clause
"""Modes of tracking over a stage that is not quite its model."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_controller.feedback.feedback_before_inverse import FeedbackBeforeInverse
from piezo_controller.feedback.feedback_design import design_feedback
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.feedforward.periodic import plan_feedforward
from piezo_controller.references.reference import InvalidReference, Reference, sample_reference
from piezo_controller.tracking.tracking_modes import (
    FEEDBACK_METHODS,
    MODES,
    StageClock,
    feedback_room_v,
    plan_mode,
)
from piezo_controller.tracking.tracking_run import TrackingRun
from piezo_studies.thesis.offline_loop import play_run

STAGE = StageClock()
DURATION_S = 0.1


def harmonic(frequency_hz, amplitude_um=20.0):
    return Reference("harmonic", (frequency_hz,), (amplitude_um,), (), 50.0)


@pytest.fixture(scope="module")
def other_stage(stage_model):
    """Return the stage with a hysteresis that has 3 % more gain than the model's."""
    hysteresis = stage_model.hysteresis
    return replace(stage_model, hysteresis=replace(
        hysteresis, density_um_per_v2=1.03 * hysteresis.density_um_per_v2))


@pytest.fixture(scope="module")
def error_percent(stage_model, controller, other_stage, exchange_with):
    def track(mode, frequency_hz):
        plan = plan_mode(mode, harmonic(frequency_hz), stage_model, STAGE, DURATION_S)
        feedback = None
        if mode in ("pid", "pi"):
            tuned = design_feedback(stage_model, load_weights(), method=mode)
            feedback = MultirateFeedback(tuned, feedback_room_v(plan, STAGE.voltage_range_v))
        elif mode in FEEDBACK_METHODS:
            feedback = MultirateFeedback(controller)
        run = TrackingRun(plan, round(DURATION_S * STAGE.sample_rate_hz), feedback)
        play_run(run, plan, exchange_with(other_stage, 1.0), STAGE.samples_per_tick)
        return run.e_rms_percent()

    return track


def test_feedback_alone_follows_a_slow_reference_and_the_composite_does_better(error_percent):
    errors = {mode: error_percent(mode, 10.0) for mode in MODES}
    assert errors["composite"] < 0.3 * min(errors["pid"], errors["pi"])
    assert max(errors["pid"], errors["pi"]) < errors["open_loop"]
    assert errors["composite"] < 0.2 * errors["feedforward"]


def test_single_slow_rate_follows_a_slow_reference_and_fails_near_its_own_rate(error_percent):
    assert error_percent("composite_single_rate", 10.0) < 2 * error_percent("composite", 10.0) + 0.5
    assert error_percent("composite_single_rate", 250.0) > 5 * error_percent("composite", 250.0)


def test_single_rate_holds_its_feedforward_for_a_tick_and_expects_the_reference(stage_model):
    plan = plan_mode("composite_single_rate", harmonic(125.0), stage_model, STAGE, DURATION_S)
    held_v = plan.period_voltage_v.reshape(-1, STAGE.samples_per_tick)
    assert (held_v == held_v[:, :1]).all()
    assert plan.reference_period_um == pytest.approx(
        np.resize(sample_reference(harmonic(125.0)), plan.period_voltage_v.size))
    assert plan.feedback_start_sample % STAGE.samples_per_tick == 0
    assert plan.once_voltage_v.size == plan.reference_once_um.size


def test_single_rate_of_a_sample_is_the_multirate_plan(stage_model):
    fast = replace(STAGE, samples_per_tick=1)
    plans = [plan_mode(mode, harmonic(500.0), stage_model, fast, DURATION_S)
             for mode in ("composite", "composite_single_rate")]
    for first, second in zip(vars(plans[0]).values(), vars(plans[1]).values(), strict=True):
        np.testing.assert_array_equal(first, second)


def test_single_rate_refuses_a_reference_as_fast_as_itself(stage_model):
    with pytest.raises(InvalidReference, match="half the sample rate of 1000 Hz"):
        plan_mode("composite_single_rate", harmonic(1000.0), stage_model, STAGE, DURATION_S)


def test_feedback_alone_is_given_a_constant_voltage_and_the_whole_reference(stage_model):
    plan = plan_mode("pid", harmonic(40.0), stage_model, STAGE, DURATION_S)
    assert np.ptp(plan.period_voltage_v) < 1e-6
    assert plan.reference_period_um == pytest.approx(sample_reference(harmonic(40.0)))
    # Faded in, it is continuous with the periodic part and begins where the mean is held.
    joined = np.r_[plan.reference_once_um, plan.reference_period_um]
    steps = np.abs(np.diff(joined[plan.feedback_start_sample:]))
    assert steps.max() < 2 * np.abs(np.diff(plan.reference_period_um)).max()
    held_v = plan.period_voltage_v[0]
    room_v = feedback_room_v(plan, STAGE.voltage_range_v)
    assert room_v == pytest.approx(min(held_v + 20, 120 - held_v))


def test_unknown_mode_is_refused(stage_model):
    with pytest.raises(ValueError, match="unknown mode 'closed': use one of open_loop, pid, pi"):
        plan_mode("closed", harmonic(40.0), stage_model, STAGE, DURATION_S)


def test_answer_before_the_inverse_moves_the_hysteresis_by_what_the_controller_wants(
        stage_model, controller):
    # Held at one point the inverse of target + wanted is exact, at the gain of the very branch.
    plan = plan_feedforward(np.full(40, 50.0), stage_model, duration_s=DURATION_S)
    through = FeedbackBeforeInverse(controller, stage_model, plan, STAGE.samples_per_tick)
    plain = MultirateFeedback(controller)
    gain_um_per_v = controller.report["hysteresis_gain_um_per_v"]
    hysteresis = stage_model.hysteresis
    memory = stage_model.memory().hysteresis
    first = plan.feedback_start_sample + 2 * STAGE.samples_per_tick
    hysteresis.simulate(plan.voltage_v(0, first), memory)
    before_um = memory.hysteresis_um
    for error_um in (0.5, 0.3, -0.2, -0.4):
        voltage_v = through.step(error_um, 0.0)
        wanted_um = gain_um_per_v * plain.step(error_um, 0.0)
        reached_um = hysteresis.simulate(
            plan.voltage_v(first, STAGE.samples_per_tick) + voltage_v, memory)[-1]
        assert reached_um - before_um == pytest.approx(wanted_um, abs=2e-3)
        first += STAGE.samples_per_tick


def test_feedback_before_the_inverse_tracks_as_well(stage_model, controller, other_stage,
                                                    exchange_with):
    plan = plan_mode("composite", harmonic(40.0, 60.0), stage_model, STAGE, DURATION_S)
    errors = []
    for feedback in (MultirateFeedback(controller), FeedbackBeforeInverse(
            controller, stage_model, plan, STAGE.samples_per_tick)):
        run = TrackingRun(plan, round(DURATION_S * STAGE.sample_rate_hz), feedback)
        play_run(run, plan, exchange_with(other_stage, 1.0), STAGE.samples_per_tick)
        errors.append(run.e_rms_percent())
    assert errors[1] < 1.2 * errors[0]
