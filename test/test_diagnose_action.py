# SPDX-License-Identifier: BSD-3-Clause
"""The identification node finds what a model lacks, asked by an action."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from piezo_client.client import GoalFailed
from piezo_client.stage import Stage
from piezo_identification.experiments.catalogue import validation
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import load_model, save_model

MODE = VibrationMode(8796.0, 0.02, 0.05)
NOISE_UM = 0.009


@pytest.fixture(scope="module")
def files(plain_model, save_csv, tmp_path_factory):
    """A model, and recordings of a stage that has one mode more."""
    directory = tmp_path_factory.mktemp("lacking")
    paths = {"model": directory / "model.json"}
    save_model(paths["model"], IdentifiedModel(plain_model, (-20.0, 120.0)))
    for seed, name in enumerate(("data", "holdout")):
        voltage_v = validation(arc_s=0.01, tones_s=0.1 + 0.05 * seed).voltage_v
        displacement_um = replace(plain_model, effects=(MODE,)).simulate(voltage_v, 25e-6)
        displacement_um += NOISE_UM * np.random.default_rng(seed).normal(size=voltage_v.size)
        paths[name] = save_csv(directory / f"{name}.csv", 25e-6 * np.arange(voltage_v.size),
                               voltage_v, displacement_um)
    return paths


@pytest.fixture(scope="module")
def diagnosed(whole_suite, files, tmp_path_factory):
    """What the node told on its way, and its result."""
    told = []
    return told, whole_suite.diagnose(
        files["model"], [files["data"]], tmp_path_factory.mktemp("of_node") / "diagnosis",
        files["holdout"], on_feedback=told.append)


def test_the_missing_effect_is_named_and_the_model_extended(diagnosed, files):
    told, result = diagnosed
    assert (result.success, result.verdict, result.effects) == (
        True, "explained", ["vibration_mode"])
    assert "lacks vibration_mode" in result.sentence
    found, = load_model(result.extended_model).model.effects
    assert found.frequency_rad_per_s == pytest.approx(MODE.frequency_rad_per_s, rel=1e-3)
    verdict = json.loads(result.verdict_json)
    assert verdict == json.loads(Path(result.report).with_name("verdict.json").read_text())
    assert verdict["holdout"]["source"] == str(files["holdout"])
    assert verdict["before"] == {"rms_um": result.before_rms_um,
                                 "e_y_percent": result.before_e_y_percent}
    assert verdict["after"] == {"rms_um": result.after_rms_um,
                                "e_y_percent": result.after_e_y_percent}
    assert result.after_rms_um < 1.1 * NOISE_UM < 0.5 * result.before_rms_um
    assert Path(result.report).read_text().startswith("<!DOCTYPE html>")

    fractions = [feedback.fraction for feedback in told]
    assert fractions == sorted(fractions)
    assert 0.0 <= fractions[0] < fractions[-1] <= 1.0
    assert {"read the recordings", "effect 1: delay"} <= {feedback.stage for feedback in told}


def test_a_script_finds_that_the_extended_model_lacks_nothing(suite, files, diagnosed, tmp_path):
    own = diagnosed[1].extended_model
    with Stage("/left") as stage:
        found = suite.beside(
            stage.diagnose, own, [files["data"]], tmp_path / "second", files["holdout"])
    assert (found.verdict, found.effects) == ("none", ())
    assert found.details["before"] == found.details["after"]
    assert found.report == tmp_path / "second" / "report.html"
    assert load_model(found.path).model.effects == load_model(own).model.effects


def test_a_diagnosis_whose_time_is_over_says_what_it_has_not_tried(suite, files, tmp_path):
    def in_s(seconds):
        parameter = Parameter("budget_s", value=seconds).to_parameter_msg()
        assert suite.call(SetParameters, "identification/set_parameters",
                          parameters=[parameter]).results[0].successful
    in_s(1e-3)
    try:
        result = suite.goal("diagnose", model=str(files["model"]), directory=str(tmp_path),
                            recordings=[str(files["data"])])
    finally:
        in_s(0.0)
    assert result.message.startswith("the time of 0.001 s does not suffice; not tried: ")
    assert json.loads(result.verdict_json)["not_tried"] == result.message


@pytest.mark.parametrize(("change", "sentence"), [
    ({"recordings": []}, "there is no recording to diagnose"),
    ({"recordings": ["/no/recording"]}, "/no/recording does not exist"),
    ({"model": "/no/model.json"}, "/no/model.json.*No such file"),
    ({"holdout": "/no/holdout"}, "/no/holdout does not exist"),
    ({"directory": "/proc/nothing"}, "/proc/nothing: .*choose another directory"),
])
def test_what_cannot_be_used_is_refused_in_one_sentence(suite, files, tmp_path, change, sentence):
    fields = {"model": str(files["model"]), "recordings": [str(files["data"])],
              "directory": str(tmp_path / "diagnosis"), **change}
    with pytest.raises(GoalFailed) as failure:
        suite.goal("diagnose", **fields)
    message = failure.value.result.message
    assert re.search(sentence, message)
    assert "\n" not in message and "Errno" not in message
    assert not (tmp_path / "diagnosis" / "verdict.json").exists()


def test_a_cancelled_diagnosis_leaves_no_verdict_and_the_node_ready(suite, files, tmp_path):
    goal = suite.send_goal("diagnose", model=str(files["model"]),
                           recordings=[str(files["data"])], directory=str(tmp_path))
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED
    assert (result.success, result.message, result.verdict) == (False, "cancelled", "")
    assert not (tmp_path / "verdict.json").exists()
    with pytest.raises(GoalFailed, match="no recording"):
        suite.goal("diagnose", model=str(files["model"]), directory=str(tmp_path))
