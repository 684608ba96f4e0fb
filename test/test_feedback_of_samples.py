# SPDX-License-Identifier: BSD-3-Clause
"""A controller file of the sample clock's rate, tracked with as a user does, on board the stage."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from piezo_interfaces.msg import Reference, SampleBlock

from piezo_client.client import GoalFailed
from piezo_controller.feedback.controller_file import save_controller
from piezo_controller.feedback.feedback_design import feedback_from_control
from piezo_controller.feedback.onboard_law import onboard_law
from piezo_controller.feedback.sample_rate.demands import Demands
from piezo_controller.feedback.sample_rate.fast_design import design_at_sample_rate
from piezo_controller.feedback.sample_rate.perturbed_loops import ModelErrors, PerturbedLoops
from piezo_controller.feedback.sample_rate.tuned_over_stages import tuned_family
from piezo_controller.references.reference import Reference as PlannedReference
from piezo_controller.tracking.run_plan import plan_references
from piezo_controller.tracking.tracking_modes import StageClock
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import continue_linear, zoh
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording
from piezo_stage_driver.node.stage_settings import StageSettings
from piezo_stage_driver.safety.guards import StopLatch

PERIOD_S = 25e-6
FREQUENCY_HZ = (50.0, 100.0, 400.0, 500.0, 600.0)
REFERENCE = {"kind": "multi_frequency", "frequency_hz": FREQUENCY_HZ,
             "amplitude_um": [6.0, 6.0, 0.8, 0.6, 0.4], "centre_um": 50.0}
DURATION_S, SETTLED_S = 0.9, 0.6
DEFAULTS = SimpleNamespace(
    has_parameter=lambda name: False,
    declare_parameter=lambda name, value, descriptor: SimpleNamespace(value=value))
"""A node all of whose parameters have their default values."""


@pytest.fixture(scope="module")
def wrong_model(near_model):
    """Return a model whose feedforward leaves an error at every frequency."""
    dynamics = near_model.dynamics
    return replace(near_model, dynamics=replace(
        dynamics, time_constant_s=1.1 * dynamics.time_constant_s))


@pytest.fixture(scope="module")
def law(near_model):
    """Return the feedback with resonances at 50 Hz and 100 Hz."""
    family = tuned_family(near_model, Demands(), PERIOD_S)
    return family.controller(family.start)


@pytest.fixture(scope="module")
def files(wrong_model, law, tmp_path_factory):
    directory = tmp_path_factory.mktemp("files")
    save_model(directory / "model.json", IdentifiedModel(wrong_model, (-20.0, 120.0)))
    save_controller(directory / "samples.json", feedback_from_control(
        law, wrong_model, PERIOD_S, delay_ticks=0))
    return directory


def tracked_part(result):
    recording = read_recording(result.recording)
    return recording.select(recording.has(SampleBlock.FLAG_TRACKING))


def errors_um(result, plan):
    """Return the complex amplitudes of the error, at the reference's frequencies."""
    tracked = tracked_part(result)
    count = round(DURATION_S / PERIOD_S)
    last = slice(round(SETTLED_S / PERIOD_S), count)
    error_um = (plan.expected_um(0, count) - tracked.displacement_um[:count])[last]
    waves = np.exp(-2j * np.pi * np.outer(FREQUENCY_HZ, np.arange(error_um.size) * PERIOD_S))
    return 2 / error_um.size * waves @ error_um


def the_reference():
    return PlannedReference("multi_frequency", FREQUENCY_HZ, tuple(REFERENCE["amplitude_um"]), (),
                            REFERENCE["centre_um"])


def track(client, files, directory, mode, **fields):
    directory.mkdir()
    return client.goal("track", reference=Reference(**REFERENCE), mode=mode,
                       model=str(files / "model.json"), duration_s=DURATION_S,
                       directory=str(directory), **fields)


@pytest.mark.long  # test_feedback_on_board.py plays such a law, and the design has its unit tests
def test_the_simulated_stage_attenuates_as_designed_up_to_beyond_its_first_mode(
        nodes, files, law, near_model, wrong_model, tmp_path):
    client = nodes.start("recorder", "controller", namespace="/samples")
    without, fed_back = (
        track(client, files, tmp_path / mode, mode, **fields) for mode, fields in (
            ("feedforward", {}),
            ("composite", {"controller": str(files / "samples.json")})))
    plan = plan_references("feedforward", [the_reference()], [DURATION_S], wrong_model,
                           StageClock())
    sensitivity = errors_um(fed_back, plan) / errors_um(without, plan)
    plant = PerturbedLoops(near_model, ModelErrors(), PERIOD_S, delay_ticks=0).plants[0]
    points = np.exp(2j * np.pi * np.array(FREQUENCY_HZ) * PERIOD_S)
    expected = 1 / (1 + (plant * law)(points, squeeze=True))
    assert 20 * np.log10(np.abs(sensitivity[0])) < -30.0
    assert 20 * np.log10(np.abs(sensitivity[1])) < -20.0
    # From reference to displacement the loop has not yet fallen to -3 dB.
    assert np.abs(1 - sensitivity[3]) > np.sqrt(0.5)
    np.testing.assert_allclose(sensitivity, expected, atol=0.15)
    # The law began gently, on a stage that the run before had left creeping.
    begin = plan.feedback_start_sample
    fed_back_v = (tracked_part(fed_back).voltage_v[:begin + 4000]
                  - plan.voltage_v(0, begin + 4000))
    assert np.abs(fed_back_v[:begin]).max() < 1e-9
    assert np.abs(fed_back_v[begin:begin + 80]).max() < 0.2 < np.abs(fed_back_v).max()


def test_a_loop_that_is_answered_by_messages_refuses_it(nodes, files, tmp_path):
    client = nodes.start("recorder", "controller", namespace="/answered",
                         node_parameters={"controller": {"feedback": "remote"}})
    with pytest.raises(GoalFailed, match=r"samples.json: answers every sample"):
        track(client, files, tmp_path / "run", "composite",
              controller=str(files / "samples.json"))


class DrawnStage:
    """A stage that is a model, with noise, in the state in which it was left."""

    sample_rate_hz = 1.0 / PERIOD_S

    def __init__(self, model, seed):
        memory = model.memory()
        self._hysteresis, self._memory = model.hysteresis, memory.hysteresis
        self._linear, self._state = zoh(model.linear(), PERIOD_S), memory.linear_state
        self._draws, self.measured_um = np.random.default_rng(seed), []

    def exchange(self, voltage_v):
        hysteresis_um = self._hysteresis.simulate(voltage_v, self._memory)
        displacement_um, self._state = continue_linear(self._linear, hysteresis_um, self._state)
        displacement_um += self._draws.normal(scale=0.009, size=voltage_v.size)
        self.measured_um.append(displacement_um)
        return displacement_um


def drawn(model, rng, deviation):
    """Return a model whose gain, lag, modes and damping each deviate by up to about as much."""
    def factor():
        return float(np.exp(rng.uniform(-deviation, deviation)))

    hysteresis, dynamics, speed = model.hysteresis, model.dynamics, factor()
    return replace(
        model,
        hysteresis=replace(
            hysteresis, density_um_per_v2=factor() * hysteresis.density_um_per_v2),
        dynamics=replace(
            dynamics, time_constant_s=factor() * dynamics.time_constant_s,
            mode_frequencies_rad_per_s=tuple(
                speed * frequency for frequency in dynamics.mode_frequencies_rad_per_s),
            damping_ratios=tuple(factor() * ratio for ratio in dynamics.damping_ratios)))


def finish(engine):
    while not engine.idle or engine.holds_block:
        engine.advance()


def errors_after_a_past(stage, plan, law, past_v):
    """Play a voltage that no plan knows of, then track; return the errors, and why it stopped."""
    engine = StageSettings(DEFAULTS).create_engine(stage, StopLatch())
    engine.commands.play(past_v, 1e-3)
    finish(engine)
    before = sum(map(len, stage.measured_um))
    engine.commands.load_feedforward(plan.once_voltage_v, plan.period_voltage_v)
    if law is not None:
        engine.commands.load_feedback(engine.commands.checked(law))
    engine.commands.start_tracking(False, 1600, "", law is not None)
    finish(engine)
    counted = slice(plan.feedback_start_sample + 8000, plan.feedback_start_sample + 32000)
    measured_um = np.concatenate(stage.measured_um)[before:][counted]
    return plan.expected_um(0, counted.stop)[counted] - measured_um, engine.stop_cause


@pytest.mark.long  # each is designed for, which takes 10 s
@pytest.mark.parametrize("seed", range(20))
def test_the_default_method_works_on_a_drawn_stage_that_did_not_settle(near_model, seed):
    rng = np.random.default_rng(seed)
    stage = drawn(near_model, rng, 0.3)
    model = drawn(stage, rng, 0.03)  # as far off as one that was identified
    lowest_um, highest_um = model.hysteresis.output_range_um
    span_um = highest_um - lowest_um
    reference = PlannedReference(
        "multi_frequency", (100.0, 300.0), (0.12 * span_um, 0.01 * span_um), (),
        lowest_um + rng.uniform(0.4, 0.6) * span_um)
    plan = plan_references("feedforward", [reference], [1.0], model, StageClock())
    law = onboard_law(design_at_sample_rate(model), model, plan, PERIOD_S, 20.0,
                      before_inverse=True, max_error_um=4.0)
    past_v = np.interp(np.arange(700), 100.0 * np.arange(8), rng.uniform(0.0, 80.0, 8))
    (left_um, cause), (without_um, _) = (
        errors_after_a_past(DrawnStage(stage, seed), plan, law, past_v) for law in (law, None))
    assert cause == ""
    assert np.sqrt(np.mean(left_um**2)) < 0.2 * np.sqrt(np.mean(without_um**2))
