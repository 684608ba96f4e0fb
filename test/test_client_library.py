# SPDX-License-Identifier: BSD-3-Clause
"""A script drives a stage by blocking calls, and so does the command line."""

import os
import signal
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from ament_index_python.packages import get_package_prefix
from piezo_interfaces.msg import SampleBlock
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from piezo_client.client import GoalFailed
from piezo_client.stage import Stage
from piezo_recorder.reading.reader import read_recording


@pytest.fixture
def stage(suite):
    with Stage("/left") as stage:
        yield stage


def start_command(*arguments):
    """Start the command `stage` for the stage /left."""
    environment = {**os.environ}
    environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)  # of this process alone
    command = Path(get_package_prefix("piezo_client"), "lib", "piezo_client", "stage")
    return subprocess.Popen(
        [command, "--namespace", "left", "--wait-s", "60", *map(str, arguments)], env=environment,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_voltage_of_ones_own_is_played_as_given_and_its_recording_opens(
        stage, suite, tmp_path):
    voltage_v = 5.0 * np.sin(2 * np.pi * np.arange(400) / 400)
    played = suite.beside(
        stage.play, voltage_v, repeats=2, directory=tmp_path, name="sine").recording()
    assert Path(played.path) == tmp_path / "sine"
    assert played.gaps == []
    np.testing.assert_array_equal(played.voltage_v[played.playing], np.tile(voltage_v, 2))
    again = suite.beside(stage.play, voltage_v, directory=tmp_path, name="sine")
    assert again.path == tmp_path / "sine_2"


def test_experiment_tells_its_steps_and_returns_its_recording(suite, tmp_path):
    told = []
    with Stage("/left", progress=lambda *progress: told.append(progress)) as stage:
        experiment = suite.beside(stage.run_experiment, "dynamics", tmp_path)
    assert experiment.path == tmp_path / "dynamics"
    assert "square wave" in experiment.summary
    assert experiment.recording().gaps == []
    assert {"dynamics: play"} <= {step for step, _, _ in told}
    assert all(0.0 <= fraction <= 1.0 and left >= 0.0 for _, fraction, left in told)


def test_refusal_carries_the_text_of_the_node(stage, tmp_path):
    with pytest.raises(GoalFailed, match="cannot read the model.*identify the stage first"):
        stage.track({"kind": "harmonic"}, tmp_path / "none.json", directory=tmp_path)


def test_stage_that_was_stopped_moves_again_after_reset(stage, suite, tmp_path):
    stage.emergency_stop()
    with pytest.raises(GoalFailed, match="stopped"):
        stage.play([1.0], directory=tmp_path)
    suite.until(lambda: suite.trigger("reset").success)
    played = suite.beside(stage.play, [1.0], directory=tmp_path)
    assert played.recording().voltage_v.max() == 1.0


def test_settling_goes_to_the_lowest_voltage_and_rests(stage, suite):
    suite.beside(stage.settle, rest_s=1)
    voltage_v = suite.samples().voltage_v
    assert voltage_v.min() == -20.0
    assert voltage_v[-1] == 0.0


def test_command_runs_an_experiment_and_says_where_its_recording_is(suite, tmp_path):
    command = start_command("experiment", "dynamics", "--output", tmp_path)
    printed, told = suite.beside(command.communicate, timeout=300)
    assert command.returncode == 0, told
    *_, recorded, following = printed.splitlines()
    assert recorded == f"recorded {tmp_path / 'dynamics'}"
    assert following == f"next: ./run piezo_identification check --data {tmp_path / 'dynamics'}"
    assert "dynamics: play" in told.splitlines()
    assert read_recording(tmp_path / "dynamics").gaps == []


def test_command_that_is_interrupted_brings_the_stage_to_rest(suite, endless):
    command = start_command("experiment", "dynamics", "--output", endless)
    suite.until_any(lambda block: np.any(block.voltage_v))
    command.send_signal(signal.SIGINT)
    _, told = suite.beside(command.communicate, timeout=300)
    assert command.returncode == 130, told
    assert told.splitlines()[-1].startswith("stage: interrupted")
    recording = read_recording(endless / "dynamics")
    assert recording.complete
    assert recording.voltage_v[-1] == 0.0


def test_what_can_no_longer_be_recorded_is_stopped(stage, suite, tmp_path):
    def fill_disk(megabytes):
        parameter = Parameter("minimum_free_mb", value=megabytes).to_parameter_msg()
        return suite.call(SetParameters, "recorder/set_parameters", parameters=[parameter])

    with ThreadPoolExecutor(1) as thread:
        played = thread.submit(stage.play, [30.0] * 400, 0.1, 1_000_000, tmp_path)
        suite.until_flagged(SampleBlock.FLAG_PLAYING)
        fill_disk(1_000_000_000)
        suite.until(played.done)
    fill_disk(1)
    with pytest.raises(GoalFailed, match=f"{tmp_path}/waveform was closed early: only"):
        played.result()
    assert suite.samples().voltage_v[-1] == 0.0
