# SPDX-License-Identifier: BSD-3-Clause
"""A controller file of the sample clock's rate, tracked with as a user does, on board the stage."""

from dataclasses import replace

import numpy as np
import pytest
from piezo_interfaces.msg import Reference, SampleBlock

from piezo_client.client import GoalFailed
from piezo_controller.feedback.controller_file import save_controller
from piezo_controller.feedback.feedback_design import feedback_from_control
from piezo_controller.feedback.sample_rate.demands import Demands
from piezo_controller.feedback.sample_rate.perturbed_loops import ModelErrors, PerturbedLoops
from piezo_controller.feedback.sample_rate.tuned_over_stages import tuned_family
from piezo_controller.references.reference import Reference as PlannedReference
from piezo_controller.tracking.run_plan import plan_references
from piezo_controller.tracking.tracking_modes import StageClock
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording

PERIOD_S = 25e-6
FREQUENCY_HZ = (50.0, 100.0, 400.0, 500.0, 600.0)
REFERENCE = {"kind": "multi_frequency", "frequency_hz": FREQUENCY_HZ,
             "amplitude_um": [6.0, 6.0, 0.8, 0.6, 0.4], "centre_um": 50.0}
DURATION_S, SETTLED_S = 0.9, 0.6


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
