# SPDX-License-Identifier: BSD-3-Clause
"""The controller with a controller file, a tick of one sample, and feedback before the inverse."""

import json
from dataclasses import replace

import pytest
from piezo_interfaces.msg import Reference

from piezo_client.client import GoalFailed
from piezo_client.stage import Stage
from piezo_controller.feedback.controller_file import save_controller
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording

REFERENCE = {"kind": "harmonic", "frequency_hz": [40.0], "amplitude_um": [20.0], "centre_um": 50.0}


@pytest.fixture(scope="module")
def files(near_model, near_controller, tmp_path_factory):
    """Paths of the model and of controllers for it, one of which makes the loop unstable."""
    directory = tmp_path_factory.mktemp("files")
    save_model(directory / "model.json", IdentifiedModel(near_model, (-20.0, 120.0)))
    save_controller(directory / "stable.json", near_controller)
    save_controller(directory / "unstable.json", replace(
        near_controller, C=3 * near_controller.C, D=3 * near_controller.D))
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
        nodes, files, tmp_path, monkeypatch):
    with pytest.raises(GoalFailed, match=r"unstable.json: the controller does not stabilise"):
        track(nodes, "/unstable", files, tmp_path,
              {"controller_file": str(files / "unstable.json")})
    assert list(tmp_path.iterdir()) == []
    # That of a goal goes before that of the node; its path is of the folder of who asks.
    monkeypatch.chdir(files)
    with Stage("/unstable") as stage:
        tracked = stage.track(REFERENCE, "model.json", duration_s=0.2, directory=tmp_path,
                              controller="stable.json")
    assert tracked.e_rms_percent < 0.5
    parameters = json.loads(read_recording(tracked.path).attachments["parameters.json"])
    assert parameters["controller"] == str(files / "stable.json")


@pytest.mark.long
def test_single_rate_of_a_short_tick_tracks(nodes, files, tmp_path):
    assert single_rate(nodes, files, tmp_path, 10).e_rms_percent < 1.0


@pytest.mark.long
def test_single_rate_of_the_sample_clock_tracks_and_tells_that_it_is_too_slow_for_it(
        nodes, files, tmp_path):
    result = single_rate(nodes, files, tmp_path, 1)
    assert result.e_rms_percent < 1.0
    assert "the tick of 25 us" in result.message


def single_rate(nodes, files, directory, samples):
    """Track with a feedback that acts each so many samples, answered by messages."""
    return track(nodes, f"/fast_{samples}", files, directory,
                 {"samples_per_tick": samples, "feedback": "remote"},
                 "composite_single_rate", 0.025, samples_per_tick=samples)
