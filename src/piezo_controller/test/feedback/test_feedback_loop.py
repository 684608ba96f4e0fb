# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_controller.feedback.feedback_design import design_feedback
from piezo_controller.feedback.multirate_feedback import MultirateFeedback
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_controller.feedforward.periodic import plan_feedforward
from piezo_controller.references.reference import Reference, sample_reference
from piezo_controller.tracking.tracking_run import TrackingRun
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_studies.thesis.offline_loop import play_run

pytestmark = pytest.mark.kernels

SAMPLES = 40


@pytest.fixture(scope="module")
def disturbed_stage(stage_model):
    """Return a stage with other parameters than its model."""
    hysteresis, creep, dynamics = stage_model.hysteresis, stage_model.creep, stage_model.dynamics
    return StageModel(
        PreisachModel(-20.0, 120.0, 1.01 * hysteresis.density_um_per_v2, hysteresis.offset_um),
        CreepDynamics([1.1 * p for p in creep.poles_rad_per_s],
                      [1.1 * z for z in creep.zeros_rad_per_s]),
        ElectricVibrationDynamics(1.01 * dynamics.time_constant_s,
                                  [0.995 * w for w in dynamics.mode_frequencies_rad_per_s],
                                  dynamics.damping_ratios))


@pytest.fixture
def tracking_error_percent(exchange_with):
    def error_percent(stage, plan, feedback, offset_um):
        run = TrackingRun(plan, 200 * SAMPLES, feedback)
        play_run(run, plan, exchange_with(stage, offset_um), SAMPLES)
        return run.e_rms_percent()

    return error_percent


@pytest.mark.parametrize("frequency_hz, amplitude_um, limit_percent", [
    (40.0, 40.0, 0.06), (100.0, 40.0, 0.1), (500.0, 21.0, 0.1), (1000.0, 9.0, 0.15)])
def test_exact_model_tracks_at_the_sensors_floor(
        stage_model, controller, tracking_error_percent, frequency_hz, amplitude_um,
        limit_percent):
    reference_um = sample_reference(
        Reference("harmonic", (frequency_hz,), (amplitude_um,), (), 50.0))
    plan = plan_feedforward(reference_um, stage_model, duration_s=0.2)
    error = tracking_error_percent(stage_model, plan, MultirateFeedback(controller), 0.0)
    assert error < limit_percent


@pytest.mark.parametrize("frequency_hz, amplitude_um", [(40.0, 40.0), (500.0, 21.0)])
def test_feedback_removes_an_offset_and_what_the_model_does_not_know(
        stage_model, disturbed_stage, controller, tracking_error_percent, frequency_hz,
        amplitude_um):
    reference_um = sample_reference(
        Reference("harmonic", (frequency_hz,), (amplitude_um,), (), 50.0))
    plan = plan_feedforward(reference_um, stage_model, duration_s=0.2)
    alone = tracking_error_percent(disturbed_stage, plan, None, 3.0)
    composite = tracking_error_percent(disturbed_stage, plan, MultirateFeedback(controller), 3.0)
    assert alone > 5
    assert composite < 0.2 * alone


def test_step_is_the_controllers_state_equation(controller):
    feedback = MultirateFeedback(controller, max_feedback_v=1e9)
    errors_um = np.random.default_rng(2).normal(size=50)
    state, expected_v = np.zeros(len(controller.A)), []
    for error_um in errors_um:
        expected_v.append((controller.C @ state + controller.D[0] * error_um).item())
        state = controller.A @ state + controller.B[:, 0] * error_um
    given_v = [feedback.step(error_um + np.array([1.0, 3.0]), np.array([0.0, 4.0]))
               for error_um in errors_um]
    np.testing.assert_allclose(given_v, expected_v, rtol=1e-9)


def test_reset_forgets(controller):
    feedback = MultirateFeedback(controller)
    first_v = [feedback.step(e, 0.0) for e in (1.0, 2.0, 3.0)]
    feedback.reset()
    assert [feedback.step(e, 0.0) for e in (1.0, 2.0, 3.0)] == first_v


def test_limited_voltage_comes_back_at_once_when_the_error_turns(controller):
    feedback = MultirateFeedback(controller, max_feedback_v=5.0)
    limited_v = [feedback.step(10.0, 0.0) for _ in range(1000)]
    assert limited_v[-1] == 5.0 and max(limited_v) == 5.0
    back_v = [feedback.step(-1.0, 0.0) for _ in range(20)]
    assert back_v[-1] < 0


def test_limit_of_zero_is_refused(controller):
    with pytest.raises(ValueError, match="positive voltage"):
        MultirateFeedback(controller, max_feedback_v=0.0)


def test_controller_with_an_integrator_comes_back_from_the_limit(stage_model):
    integrator = design_feedback(stage_model, load_weights(), method="pi")
    feedback = MultirateFeedback(integrator, max_feedback_v=5.0)
    assert [feedback.step(10.0, 0.0) for _ in range(1000)][-1] == 5.0
    # An integrator that had gone on for 1000 ticks would take 10,000 to come back.
    back_v = [feedback.step(-1.0, 0.0) for _ in range(40)]
    assert back_v[20] < 5.0 and back_v[-1] < 0


def test_observer_gain_keeps_the_limited_state_stable(controller):
    feedback = MultirateFeedback(controller)
    limited_a = controller.A - np.outer(feedback._observer, controller.C)
    assert np.abs(np.linalg.eigvals(limited_a)).max() < 1
