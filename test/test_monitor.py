# SPDX-License-Identifier: BSD-3-Clause
"""A stage that changes while it tracks: suspected, diagnosed, offered, accepted, tracked better."""

from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from piezo_client.client import GoalFailed
from piezo_client.model_offers import accept_extended_model, offered_model
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import load_model, save_model
from piezo_recorder.reading.reader import read_recording

pytestmark = pytest.mark.long

REFERENCE = {"kind": "multi_frequency", "frequency_hz": [50.0, 400.0, 750.0],
             "amplitude_um": [20.0, 8.0, 4.0], "centre_um": 57.0}
CHANGE_S = 3.0
FASTER = 1.03


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    """The default plant, but its second mode is faster by 3 % from a time on."""
    sections = yaml.safe_load((resources.files("piezo_sim") / "plant.yaml").read_text("utf-8"))
    mode = sections["stage"][-1]

    def stated(value, unit):
        return {"value": value, "unit": unit, "source": "test"}

    sections["stage"][-1] = mode | {
        "effect": "loaded_mode", "added_mass": stated(FASTER**-2 - 1.0, "1"),
        "added_stiffness": stated(0.0, "1"), "begin_s": stated(CHANGE_S, "s")}
    path = tmp_path_factory.mktemp("plant") / "changing.yaml"
    path.write_text(yaml.safe_dump(sections))
    return path


@pytest.fixture(scope="module")
def model(near_model, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "model.json"
    save_model(path, IdentifiedModel(near_model, (-20.0, 120.0)))
    return path


@pytest.fixture(scope="module")
def stage(nodes, plant):
    return nodes.start(
        "recorder", "controller", "monitor", namespace="/monitored", plant=plant, node_parameters={
            "monitor": {"block_s": 0.1, "learning_blocks": 20, "diagnosed_s": 0.5}})


@pytest.fixture(scope="module")
def heard(stage):
    """What the monitor tells of the model."""
    states = []
    stage.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda message: states.extend(
            status for status in message.status if status.name == "/monitored/monitor: model"), 10)
    return states


@pytest.fixture(scope="module")
def offer(stage, heard, model, tmp_path_factory):
    """What the monitor offers after a run in which the mode changed."""
    stage.track(REFERENCE, model, "composite", 4.5, tmp_path_factory.mktemp("changing"))
    stage.until(lambda: any(values(status).get("found") for status in heard))
    return offered_model(stage)


def values(status):
    return {entry.key: entry.value for entry in status.values}


def test_the_change_is_suspected_with_its_time_and_its_band(offer, heard):
    assert heard[0].level in (DiagnosticStatus.STALE, DiagnosticStatus.OK)
    suspected = next(status for status in heard if status.level == DiagnosticStatus.WARN)
    told = values(suspected)
    assert abs(float(told["since_s"]) - CHANGE_S) <= 0.2
    assert CHANGE_S < float(told["suspected_s"]) < CHANGE_S + 1.0
    assert float(told["probability"]) > 0.99
    assert float(told["rms_um"]) > 2.0 * float(told["usual_rms_um"])
    assert told["band_hz"] == "100 to 1000"
    assert "more samples are needed" in suspected.message or "diagnosis runs" in suspected.message


def test_the_offered_model_has_the_mode_where_it_is_now(offer, model):
    assert offer.model == model
    assert "mode_2_frequency_rad_per_s" in offer.sentence
    before, after = (load_model(path).model for path in (model, offer.path))
    found = np.array(after.dynamics.mode_frequencies_rad_per_s)
    was = np.array(before.dynamics.mode_frequencies_rad_per_s)
    assert found / was == pytest.approx([1.0, FASTER], abs=3e-3)
    assert offer.after_rms_um < 0.3 * offer.before_rms_um


def test_the_next_run_uses_an_accepted_model_says_so_and_tracks_better(
        stage, offer, model, tmp_path):
    worse = stage.track(REFERENCE, model, "composite", 0.3, tmp_path)
    assert "accepted" not in worse.message
    told = accept_extended_model(stage, model, offer.path)
    assert told == f"{offer.path} is used in place of {model} from the next run on"
    better = stage.track(REFERENCE, model, "composite", 0.3, tmp_path)
    assert better.e_rms_percent < 0.7 * worse.e_rms_percent
    assert f"used {offer.path}, which was accepted in place of {model}" in better.message
    kept = read_recording(better.recording).attachments["model.json"]
    assert kept == offer.path.read_bytes()
    accept_extended_model(stage, model, "")
    again = stage.track(REFERENCE, model, "composite", 0.3, tmp_path)
    assert "accepted" not in again.message
    assert again.e_rms_percent > 1.4 * better.e_rms_percent


def test_what_cannot_be_taken_is_refused_by_name_and_the_model_stays(
        stage, model, near_model, plain_model, tmp_path):
    other = tmp_path / "other.json"
    save_model(other, IdentifiedModel(plain_model, (-20.0, 120.0)))
    with pytest.raises(GoalFailed, match="other.json has another hysteresis.* stays"):
        accept_extended_model(stage, model, other)
    far = tmp_path / "far.json"
    save_model(far, IdentifiedModel(replace(near_model, dynamics=replace(
        near_model.dynamics, mode_frequencies_rad_per_s=(200.0, 300.0))), (-20.0, 120.0)))
    with pytest.raises(GoalFailed, match="feedback .* unstable with the model that it replaces"):
        accept_extended_model(stage, model, far)
    with pytest.raises(GoalFailed, match="no.json.*No such file"):
        accept_extended_model(stage, model, tmp_path / "no.json")
