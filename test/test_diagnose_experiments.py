# SPDX-License-Identifier: BSD-3-Clause
"""The identification node plays the experiment that decides, and diagnoses again."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from piezo_interfaces.msg import SampleBlock

from piezo_client.client import GoalFailed
from piezo_models.effects.delay import Delay
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import read_recording

DELAY_S = 1e-4
NOISE_UM = 0.009
LONGEST_S = 0.1


@pytest.fixture(scope="module")
def files(plain_model, save_csv, tmp_path_factory):
    """A model, and a slow scan of a stage with a delay: a lag of the sensor explains it as well."""
    directory = tmp_path_factory.mktemp("undecided")
    model = directory / "model.json"
    save_model(model, IdentifiedModel(plain_model, (-20.0, 120.0)))
    voltage_v = 50.0 - 25.0 * np.cos(2e-3 * np.pi * np.arange(3000))
    displacement_um = replace(plain_model, effects=(Delay(DELAY_S),)).simulate(voltage_v, 1e-4)
    displacement_um += NOISE_UM * np.random.default_rng(1).normal(size=voltage_v.size)
    data = save_csv(
        directory / "scan.csv", 1e-4 * np.arange(voltage_v.size), voltage_v, displacement_um)
    return {"model": str(model), "recordings": [str(data)]}


@pytest.mark.long
def test_what_decides_is_played_recorded_and_diagnosed(suite, files, tmp_path):
    told = []
    result = suite.goal("diagnose", on_feedback=told.append, directory=str(tmp_path),
                        experiments=1, longest_s=LONGEST_S, **files)
    played, = result.recordings
    proposal = json.loads((tmp_path / "experiment_1" / "next_experiment.json").read_text())
    names = {each["effects"] for each in proposal["alternatives"]}
    assert {"delay", "sensor_lag"} <= names
    wanted_v = np.genfromtxt(
        tmp_path / "experiment_1" / "next_experiment.csv", delimiter=",", names=True)["voltage_v"]
    recording = read_recording(played)
    assert Path(played).parent == tmp_path / "experiment_1"
    assert np.allclose(recording.voltage_v[recording.playing][:wanted_v.size], wanted_v, atol=1e-6)
    assert wanted_v.size * recording.sample_periods_s[0] <= LONGEST_S + 1e-9
    verdict = json.loads(result.verdict_json)
    assert sum(verdict["probabilities"].values()) == pytest.approx(1.0)
    assert "after 1 experiment" in result.decision
    assert played in Path(result.report).read_text()
    fractions = [feedback.fraction for feedback in told]
    assert fractions == sorted(fractions)
    assert any("distinguishes " in feedback.stage and "with probability" in feedback.stage
               for feedback in told)


def test_a_cancelled_decision_leaves_the_stage_at_rest_and_what_was_recorded(
        suite, files, tmp_path):
    goal = suite.begin("diagnose", directory=str(tmp_path), experiments=1, longest_s=0.3, **files)
    suite.until_flagged(SampleBlock.FLAG_PLAYING)
    status, result = suite.cancel(goal)
    assert status == GoalStatus.STATUS_CANCELED
    assert (result.success, result.verdict) == (False, "")
    recording = read_recording(result.recordings[0])
    assert np.count_nonzero(recording.playing) > 0
    assert recording.complete and recording.voltage_v[-1] == 0.0
    assert not (tmp_path / "verdict.json").exists()


def test_a_time_that_is_none_is_refused(suite, files, tmp_path):
    with pytest.raises(GoalFailed) as failure:
        suite.goal("diagnose", directory=str(tmp_path), experiments=1, longest_s=-1.0, **files)
    assert "longest_s is -1: give how long" in failure.value.result.message
