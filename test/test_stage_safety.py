# SPDX-License-Identifier: BSD-3-Clause
"""What reaches the amplifier stays bounded, whoever answers, and whatever hangs."""

import os
import signal
import subprocess
import sys

import hanging_stage
import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from forked_processes import ForkedProcesses
from lifecycle_msgs.msg import Transition
from piezo_interfaces.msg import FeedbackVoltage, SampleBlock
from piezo_interfaces.srv import LoadFeedforward, StartTracking
from std_srvs.srv import Trigger

from piezo_ros.quality import FEEDBACK

MAX_STEP_V, MAX_FEEDBACK_V = 2.0, 20.0
HANGS_S = 3.0
"""So long each test waits, and no longer may a busy computer keep a backend from returning."""
ENDS_S = 300.0


@pytest.fixture(scope="module")
def bounded_stage(nodes):
    return nodes.start(namespace="/bounded", max_feedback_v=MAX_FEEDBACK_V,
                       max_feedback_step_v=MAX_STEP_V)


@pytest.fixture
def stage(bounded_stage):
    bounded_stage.forget()
    yield bounded_stage
    bounded_stage.answer = None
    bounded_stage.until(lambda: bounded_stage.trigger("reset").success)


@pytest.fixture
def stranger(stage):
    """Publishes feedback, and nobody asked it to."""
    feedback = stage.node.create_publisher(FeedbackVoltage, "feedback", FEEDBACK)
    stage.until(lambda: feedback.get_subscription_count() > 0)
    yield feedback
    stage.node.destroy_publisher(feedback)


def largest_step_v(samples):
    return np.abs(np.diff(samples.voltage_v)).max()


@pytest.mark.parametrize("run", [0, 7])
@pytest.mark.parametrize(("voltage_v", "times"), [(1e308, 1), (1e6, 40)])
def test_feedback_of_a_stranger_stops_the_stage_and_never_acts(
        stage, stranger, voltage_v, times, run):
    answered = []

    def answer(block):
        answered.append(block.tick)
        if len(answered) == 20:
            for _ in range(times):
                stranger.publish(FeedbackVoltage(tick=block.tick, voltage_v=voltage_v, run=run))
        return 1.0

    stage.answer = answer
    assert stage.load(np.linspace(0.0, 40.0, 400)).success
    assert stage.start_tracking(feedback=True, ticks=100_000).success
    samples = stage.samples()
    assert samples.voltage_v.max() == 41.0
    assert largest_step_v(samples) <= MAX_STEP_V
    assert samples.blocks[-1].flags == SampleBlock.FLAG_STOPPED
    assert "came from others than the client" in stage.load([0.0]).message
    warned = stage.logs().count("feedback refused")
    assert 1 <= warned <= 20


@pytest.mark.parametrize(("answer_v", "highest_v"), [(1e6, 40.0), (19.0, 48.0)])
def test_own_client_that_asks_for_too_much_is_bounded_and_stopped(stage, answer_v, highest_v):
    stage.answer = lambda block: answer_v
    assert stage.load(np.linspace(0.0, 40.0, 400)).success
    assert stage.start_tracking(feedback=True, ticks=100_000).success
    samples = stage.samples()
    assert samples.voltage_v.max() <= highest_v
    # On top of the feedforward's own.
    assert largest_step_v(samples) <= MAX_STEP_V + 40.0 / 399 + 1e-9
    assert "feedback answers in a row were beyond 20 V" in stage.load([0.0]).message


def test_answer_of_the_run_before_is_let_go_and_does_not_act(stage):
    assert stage.load([0.0]).success
    assert stage.start_tracking(feedback=False, ticks=1).success
    stage.samples()
    before = stage.run
    stage.forget()
    stage.answer = lambda block: stage._feedback.publish(FeedbackVoltage(
        tick=block.tick, voltage_v=1.5, run=before)) or 1.0
    assert stage.load([0.0]).success
    response = stage.start_tracking(feedback=True, ticks=50)
    assert response.run == before + 1
    samples = stage.samples()
    assert set(samples.flagged(SampleBlock.FLAG_TRACKING)) == {0.0, 1.0}
    assert stage.play([0.0]).success


def test_request_that_comes_twice_acts_once(stage):
    assert stage.load([0.0, 0.1]).success
    appended = [stage.call(LoadFeedforward, "load_feedforward", once_voltage_v=[0.2],
                           append=True, request_id=11) for _ in range(2)]
    assert all(response.success for response in appended)
    started = [stage.call(StartTracking, "start_tracking", ticks=1, request_id=12)
               for _ in range(2)]
    assert all(response.success for response in started)
    assert started[0] == started[1]
    samples = stage.samples()
    assert samples.flagged(SampleBlock.FLAG_TRACKING)[:4].tolist() == [0.0, 0.1, 0.2, 0.2]
    assert len(samples.flagged(SampleBlock.FLAG_TRACKING)) == 40


class HangingStage:
    """A stage whose backend hangs at 50 V until `release`; a fork, unless its end counts."""

    def __init__(self, make_client, processes, directory, namespace, own_rest=False,
                 end_counts=False, **parameters):
        self._file = directory / "released"
        parameters = {"timing": "paced", "autostart": True, "max_sensor_noise_um": 10.0,
                      **parameters}
        arguments = [str(self._file), "--ros-args", "-r", f"__ns:={namespace}",
                     *(part for name, value in parameters.items()
                       for part in ("-p", f"{name}:={str(value).lower()}"))]
        if end_counts:
            environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
            environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None)
            with processes.log("stage").open("w") as log:
                self.process = subprocess.Popen(
                    [sys.executable, hanging_stage.__file__, *arguments], env=environment,
                    stdout=log, stderr=log)
        else:
            main = hanging_stage.own_rest if own_rest else hanging_stage.main
            processes.start_main("stage", main, arguments)
            self.process = processes.process("stage")
        self.client = make_client(namespace, processes)
        self.statuses = []
        own = f"{namespace}/stage: stage"  # stages of other tests may still be there
        self.client.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda array: self.statuses.extend(
                status for status in array.status if status.name == own), 10)
        self.client.until(lambda: self.client.blocks and self.statuses)

    def play_until_it_hangs(self):
        """Begin to play 60 V; return the goal once the backend hangs."""
        goal = self.client.send_goal(
            "play_waveform", voltage_v=np.full(4000, 60.0), sample_period_s=25e-6, repeats=1000)
        # It rises by 2 V a block; all blocks in front of the one that hangs are to be read.
        self.client.until(lambda: self.client.blocks[-1].voltage_v[-1] > 47.99)
        self.client.until(self._file.with_name("released.awaited").exists)
        return goal

    def tells(self, key):
        """What the last diagnostics hold."""
        status = self.statuses[-1]
        return {value.key: value.value for value in status.values}[key], status.message

    def release(self):
        self._file.touch()

    def end(self):
        self.release()
        self.client.close()
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(ENDS_S) == 0


@pytest.fixture
def hanging(stage_client, tmp_path):
    started = []

    def start(namespace, **parameters):
        started.append(HangingStage(stage_client, processes, tmp_path, namespace, **parameters))
        return started[-1]

    with ForkedProcesses(tmp_path) as processes:
        yield start
        for stage in started:
            stage.end()
    assert "Traceback" not in (tmp_path / "stage.log").read_text()


def test_emergency_stop_of_a_stage_that_hangs_answers_that_it_failed_and_the_stop_still_acts(
        hanging):
    stage = hanging("/hangs", exchange_timeout_s=600.0, emergency_stop_timeout_s=0.3)
    client = stage.client
    goal = stage.play_until_it_hangs()
    response = client.call(Trigger, "emergency_stop")
    assert not response.success
    assert response.message.startswith("rest was not reached within")
    assert response.message.endswith("cut its supply")
    highest_v = client.blocks[-1].voltage_v[-1]
    seen = len(client.blocks)
    stage.release()
    status, result = client.result(goal)
    assert (status, result.message) == (GoalStatus.STATUS_ABORTED, "emergency stop")
    samples = client.samples(result.last_sample)
    after_v = np.concatenate([block.voltage_v for block in samples.blocks[seen:]])
    # The tick that hung was on its way up; from the next one on it goes down.
    assert after_v[:40].max() <= highest_v + 2.0
    assert np.all(np.diff(after_v[39:]) <= 0.0)
    assert samples.voltage_v[-1] == 0.0
    assert client.call(Trigger, "emergency_stop").success


def test_stage_that_hangs_stops_by_itself_and_says_so_meanwhile(hanging):
    stage = hanging("/hangs_alone", exchange_timeout_s=HANGS_S)
    goal = stage.play_until_it_hangs()
    stage.client.until(lambda: stage.tells("hangs")[0] == "True")
    stage.client.until(lambda: stage.tells("hangs")[1].endswith("cut its supply"))
    stage.release()
    _, result = stage.client.result(goal)
    assert result.message == f"the backend has not returned for {HANGS_S:g} s"
    assert stage.client.samples(result.last_sample).voltage_v[-1] == 0.0


def test_backend_that_hangs_and_has_its_own_way_to_rest_is_asked_for_it(hanging):
    stage = hanging("/hangs_safely", own_rest=True, exchange_timeout_s=HANGS_S,
                    emergency_stop_timeout_s=60.0)
    goal = stage.play_until_it_hangs()
    response = stage.client.call(Trigger, "emergency_stop")
    assert response.success
    assert stage.client.result(goal)[0] == GoalStatus.STATUS_ABORTED
    stage.client.until(lambda: stage.client.state() == "inactive")
    assert not stage.client.change_state(Transition.TRANSITION_ACTIVATE)  # it has not returned
    stage.release()
    stage.client.until(lambda: stage.client.change_state(Transition.TRANSITION_ACTIVATE))


def test_command_that_was_refused_never_acts_later(hanging):
    stage = hanging("/refuses", exchange_timeout_s=600.0)
    client = stage.client
    goal = stage.play_until_it_hangs()
    refused = client.send_goal(
        "play_waveform", voltage_v=np.full(4000, 30.0), sample_period_s=25e-6, repeats=1)
    status, result = client.result(refused)
    assert status == GoalStatus.STATUS_ABORTED
    assert "it is withdrawn" in result.message
    client.call(Trigger, "emergency_stop")
    stage.release()
    assert client.result(goal)[1].message == "emergency stop"
    client.until(lambda: client.call(Trigger, "reset").success)
    assert client.change_state(Transition.TRANSITION_DEACTIVATE)
    client.forget()
    assert client.change_state(Transition.TRANSITION_ACTIVATE)
    client.until(lambda: len(client.blocks) > 200)
    assert not client.samples().voltage_v.any()
    assert client.play(np.full(40, 10.0)).success
    assert stage.process.poll() is None


def test_node_whose_backend_hangs_can_be_ended(hanging):
    stage = hanging("/ends", end_counts=True, exchange_timeout_s=HANGS_S)
    goal = stage.play_until_it_hangs()
    stage.process.send_signal(signal.SIGTERM)
    status, result = stage.client.result(goal)
    assert status == GoalStatus.STATUS_ABORTED
    assert result.message
    assert stage.process.wait(ENDS_S) == 0
