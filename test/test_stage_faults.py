# SPDX-License-Identifier: BSD-3-Clause
"""Whatever breaks, the stage comes to rest by a ramp, says why, and its recording is whole."""

import os
import resource
import signal
import subprocess
import sys
from importlib import resources as package_files

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from piezo_interfaces.msg import SampleBlock
from piezo_interfaces.srv import StartRecording, StopRecording

from piezo_client.client import GoalFailed
from piezo_recorder.reading.reader import read_recording

RATE_HZ = 40_000
# Over before the stage is at rest.
FAULT_S = {"stuck_sensor": 0.06}
SHORT_FAULT_S = 0.02
# In the order of stage time; each begins this long after the one before it.
FAULT_DISTANCE_S = 0.5
FAULTS = [
    ("stuck_sensor", {}, "the sensor is stuck: it did not move while the voltage changed by"),
    ("silent_sensor", {}, "the sensor's reading is not a number"),
    ("off_scale_sensor", {"reading_um": 150.0}, "the sensor reads 150 um, outside [-45, 145] um"),
    ("noisy_sensor", {"noise_rms_um": 1.0}, "the sensor's noise is"),
    ("device_failure", {}, "the simulated device failed: the samples were lost"),
]
SWING_V = 70.0 - 30.0 * np.cos(2 * np.pi * np.arange(4000) / 4000)
# Plays or tracks for a client of its own name, until it is killed.
CLIENT = """
import sys
import numpy as np
from piezo_client.client import Client
from piezo_interfaces.srv import LoadFeedforward, StartTracking
namespace, name, work = sys.argv[1:]
with Client(namespace, name) as client:
    full_name = f"{namespace}/{name}"
    if work == "play":
        client.goal("play_waveform", voltage_v=[60.0] * 4000, sample_period_s=25e-6,
                    repeats=1_000_000,
                    client=full_name)
    client.call(LoadFeedforward, "load_feedforward",
                once_voltage_v=np.linspace(0, 60, 4000).tolist())
    client.call(StartTracking, "start_tracking", client=full_name)
    client.spin_until(lambda: False, 1000.0)
"""


def begin_s(number):
    return FAULT_DISTANCE_S * (number + 1)


def plant_file(path):
    content = yaml.safe_load((package_files.files("piezo_sim") / "plant.yaml").read_text())

    def told(value, unit):
        return {"value": value, "unit": unit, "source": "a test of the guards"}

    for number, (fault, further, _) in enumerate(FAULTS):
        content["sensor"].append({
            "effect": fault, "begin_s": told(begin_s(number), "s"),
            "end_s": told(begin_s(number) + FAULT_S.get(fault, SHORT_FAULT_S), "s"),
            **{name: told(value, "um") for name, value in further.items()}})
    path.write_text(yaml.safe_dump(content))
    return path


class Watcher:
    """Keeps what a stage's diagnostics say."""

    def __init__(self, stage):
        self._stage, self._statuses = stage, []
        stage.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda array: self._statuses.extend(array.status), 10)
        stage.until(lambda: self._statuses)

    def stopped(self):
        """Wait until the stage tells a stop; return its cause and its values."""
        name = f"{self._stage.node.get_namespace()}/stage: stage"
        self._statuses.clear()
        self._stage.until(lambda: any(status.name == name and status.level == DiagnosticStatus.ERROR
                                      for status in self._statuses))
        status = next(status for status in reversed(self._statuses) if status.name == name)
        return status.message, {value.key: value.value for value in status.values}


def start_recording(stage, directory, name, client=""):
    started = stage.call(StartRecording, "recorder/start_recording", directory=str(directory),
                         name=name, client=client)
    assert started.success, started.message
    return started.path


def assert_ends_at_rest(path):
    """A recording without gaps that ends with a ramp of bounded rate; return it."""
    recording = read_recording(path)
    assert recording.complete
    assert recording.gaps == []
    assert recording.voltage_v[-1] == 0.0
    steps_v = np.diff(recording.voltage_v)[recording.has(SampleBlock.FLAG_STOPPED)[1:]]
    assert np.abs(steps_v).max() < 0.051  # 2000 V/s
    return recording


def test_lost_sensor_and_failed_device_stop_the_stage(nodes, tmp_path):
    stage = nodes.start("recorder", namespace="/faulty",
                        plant=str(plant_file(tmp_path / "plant.yaml")))
    watcher = Watcher(stage)
    sample = stage.play([0.0]).last_sample + 1
    for number, (fault, _, cause) in enumerate(FAULTS):
        path = start_recording(stage, tmp_path, fault)
        with pytest.raises(GoalFailed) as failure:
            stage.play(SWING_V, repeats=40)
        result = failure.value.result
        assert result.message.startswith(cause)
        message, values = watcher.stopped()
        assert message == result.message
        assert values["phase"] in ("rest", "not active")
        assert f"stopped: {message}" in stage.logs()
        stopped_s = (result.last_sample - 1200) / RATE_HZ
        if fault == "device_failure":
            assert stage.state() == "inactive"
            assert stage.call(StopRecording, "recorder/stop_recording").success
            assert read_recording(path).complete
        else:
            # The ramp from 100 V takes 50 ms.
            assert begin_s(number) - 0.05 < stopped_s < begin_s(number) + 0.1
            assert float(values["voltage_v"]) == 0.0
            assert stage.call(StopRecording, "recorder/stop_recording",
                              last_sample=result.last_sample).success
            recording = assert_ends_at_rest(path)
            assert recording.sample_index[0] >= sample
        with pytest.raises(GoalFailed, match="the stage is stopped|is not active"):
            stage.play([0.0])
        assert stage.trigger("reset").success
        sample = result.last_sample
    assert stage.change_state(Transition.TRANSITION_ACTIVATE)
    assert stage.play([1.0]).success


@pytest.mark.parametrize("gain", [8.0, 9.0])
def test_loop_that_is_not_stable_is_stopped_before_5_um(nodes, gain):
    suite = nodes.start(namespace=f"/unstable_{gain:.0f}")
    watcher = Watcher(suite)
    feedback_v, settled_um = [0.0], []

    def answer(block):
        mean_um = np.mean(block.displacement_um)
        if len(feedback_v) < 200:
            settled_um[:] = [mean_um]
        feedback_v.append(feedback_v[-1] + gain * (settled_um[0] - mean_um))
        return feedback_v[-1] if len(feedback_v) > 200 else 0.0

    suite.answer = answer
    assert suite.load(np.linspace(0, 50, 4000)).success
    assert suite.start_tracking(feedback=True, ticks=3000).success
    message, _ = watcher.stopped()
    suite.answer = None
    assert message.startswith("the feedback oscillates with growing amplitude")
    tracked = [block for block in suite.samples().blocks
               if block.flags & SampleBlock.FLAG_TRACKING]
    oscillated_um = np.concatenate([block.displacement_um for block in tracked[200:]])
    assert np.abs(oscillated_um - settled_um[0]).max() < 5.0
    suite.until(lambda: suite.trigger("reset").success)


def test_emergency_stop_acts_in_the_very_next_tick(suite):
    for answered_ticks in (0, 30):
        suite.forget()
        suite.answer = lambda block, last=answered_ticks: 0.0 if len(suite.blocks) <= last else None
        assert suite.load(np.linspace(0, 60, 1000)).success
        assert suite.start_tracking(feedback=True).success
        # Time stands still where an answer is missing, for which the first two ticks do not wait.
        played = answered_ticks + 2
        suite.until(lambda played=played: len(suite.blocks) >= played)
        last = suite.blocks[-1]
        assert suite.trigger("emergency_stop").success
        samples = suite.samples()
        after_v = samples.since(last.first_sample + 40)
        assert samples.gapless
        assert np.all(np.diff(np.r_[last.voltage_v[-1], after_v]) <= 0.0)
        suite.until(lambda: suite.trigger("reset").success)


@pytest.fixture(scope="module")
def nodes_left_alone(nodes):
    stage = nodes.start("recorder", "identification", namespace="/left_alone")
    return stage, Watcher(stage)


@pytest.fixture
def left_alone(nodes_left_alone):
    """A stage with all that moves it, and its diagnostics; not stopped before and after."""
    stage, _ = nodes_left_alone
    stage.forget()
    yield nodes_left_alone
    stage.until(lambda: stage.trigger("reset").success)


def start_client(stage, name, work):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)
    return subprocess.Popen(
        [sys.executable, "-c", CLIENT, stage.node.get_namespace(), name, work], env=environment)


@pytest.mark.parametrize("work", [
    "play", pytest.param("track", marks=pytest.mark.long)])
def test_client_that_is_killed_stops_the_stage(left_alone, work):
    stage, watcher = left_alone
    client = start_client(stage, f"mortal_{work}", work)
    stage.until(lambda: stage.blocks and stage.blocks[-1].voltage_v[-1] == 60.0)
    with pytest.raises(GoalFailed, match=rf"the stage is busy .* for /left_alone/mortal_{work}"):
        stage.play([1.0])
    assert f"for /left_alone/mortal_{work}" in stage.start_tracking(False).message
    client.send_signal(signal.SIGKILL)
    client.wait()
    message, _ = watcher.stopped()
    assert message == f"the client /left_alone/mortal_{work} is gone"
    assert f"stopped: {message}" in stage.logs()
    samples = stage.samples()
    assert samples.gapless
    ramp_v = samples.flagged(SampleBlock.FLAG_STOPPED)
    assert np.allclose(np.diff(ramp_v[:1200]), -0.05)


def test_full_disk_stops_the_run_and_says_so(left_alone, endless):
    stage, _ = left_alone
    recorder = stage.processes.process("recorder").pid
    # Room for one chunk: how much is written at once depends on how busy the computer is.
    unlimited = resource.prlimit(recorder, resource.RLIMIT_FSIZE, (1_000_000, -1))
    try:
        with pytest.raises(GoalFailed, match="was closed early: File too large") as failure:
            stage.run_experiment("dynamics", endless)
    finally:
        resource.prlimit(recorder, resource.RLIMIT_FSIZE, unlimited)
    stage.until(lambda: stage.blocks[-1].voltage_v[-1] == 0.0)
    assert "was closed early: File too large" in stage.logs()
    recording = read_recording(failure.value.result.recording)
    assert recording.gaps == []
    assert len(recording.voltage_v) > 0
    # With room again the next one is whole.
    assert stage.run_experiment("dynamics", endless / "next").success
