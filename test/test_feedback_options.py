# SPDX-License-Identifier: BSD-3-Clause
"""The controller with a controller file, a tick of one sample, and feedback before the inverse."""

from dataclasses import replace

import numpy as np
import pytest
from piezo_interfaces.msg import Reference

from piezo_client.client import GoalFailed
from piezo_controller.feedback.controller_file import save_controller
from piezo_controller.feedback.feedback_design import design_feedback
from piezo_controller.feedback.synthesis.weights import load_weights
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import save_model

CELLS = 50
REFERENCE = {"kind": "harmonic", "frequency_hz": [40.0], "amplitude_um": [20.0], "centre_um": 50.0}


@pytest.fixture(scope="module")
def stage_model():
    """About the simulated stage, without identification."""
    centres_v = -20.0 + (np.arange(CELLS) + 0.5) * 140.0 / CELLS
    span_v, middle_v = (centres_v[:, None] - centres_v, (centres_v[:, None] + centres_v) / 2)
    density = np.tril(6e-4 + 0.078 * np.exp(-span_v / 12.0)
                      * (1 + 0.1 * np.cos(2 * np.pi * (middle_v - 60.0) / 280.0)))
    return StageModel(
        PreisachModel(-20.0, 120.0, density, -9.7),
        CreepDynamics((0.01419, 0.1684, 0.2402, 1.053, 17.57),
                      (0.01458, 0.1716, 0.241, 1.07, 18.29)),
        ElectricVibrationDynamics(0.00049, (2846.0, 4909.0), (0.68535, 0.081992)))


@pytest.fixture(scope="module")
def files(stage_model, tmp_path_factory):
    """Paths of the model and of controllers for it, one of which makes the loop unstable."""
    directory = tmp_path_factory.mktemp("files")
    save_model(directory / "model.json", IdentifiedModel(stage_model, (-20.0, 120.0)))
    stable = design_feedback(stage_model, load_weights())
    save_controller(directory / "stable.json", stable)
    save_controller(directory / "unstable.json", replace(stable, C=3 * stable.C, D=3 * stable.D))
    return directory


def track(nodes, namespace, files, directory, controller, mode="composite", duration_s=0.2,
          **stage):
    client = nodes.start("recorder", "controller", namespace=namespace,
                         node_parameters={"controller": controller}, **stage)
    return client.goal("track", reference=Reference(**REFERENCE), model=str(files / "model.json"),
                       mode=mode, duration_s=duration_s, directory=str(directory))


def test_controller_file_is_used_and_the_feedback_may_pass_the_inverse(nodes, files, tmp_path):
    tracked = track(nodes, "/before_inverse", files, tmp_path, {
        "controller_file": str(files / "stable.json"), "feedback_place": "before_inverse"})
    # Feedforward alone leaves more than 1 %.
    assert tracked.e_rms_percent < 0.5


def test_controller_that_does_not_stabilise_the_model_is_refused_and_nothing_moves(
        nodes, files, tmp_path):
    with pytest.raises(GoalFailed, match=r"unstable.json: the controller does not stabilise"):
        track(nodes, "/unstable", files, tmp_path,
              {"controller_file": str(files / "unstable.json")})
    assert list(tmp_path.iterdir()) == []


def test_single_rate_of_the_sample_clock_tracks_and_tells_that_it_is_too_slow_for_it(
        nodes, files, tmp_path):
    result = track(nodes, "/fast", files, tmp_path, {"samples_per_tick": 1},
                   "composite_single_rate", 0.025, samples_per_tick=1)
    assert result.e_rms_percent < 1.0
    assert "the tick of 25 us" in result.message
