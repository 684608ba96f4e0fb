# SPDX-License-Identifier: BSD-3-Clause
"""The demo's goals beside each other, under a client that plays the nodes."""

from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.task import Future

from piezo_client.client import GoalFailed
from piezo_studies.demo.demo_session import MEETINGS, START_TIMEOUT_S, RunningGoal, Session


class Client:
    """Tells steps of a goal, one each time somebody waits."""

    def __init__(self, *steps):
        self._steps, self._ended = iter(steps), Future()

    def send(self, name, on_feedback, **fields):
        self._tell = on_feedback
        return SimpleNamespace(get_result_async=lambda: self._ended)

    def spin_until(self, condition, timeout_s):
        while not condition():
            step = next(self._steps)
            if isinstance(step, str):
                self._tell(SimpleNamespace(stage=step))
            else:
                step(self._ended)
        return True


def ending(success):
    return lambda ended: ended.set_result(
        SimpleNamespace(result=SimpleNamespace(success=success, message="no recording")))


def test_a_file_of_a_diagnosis_is_there_before_the_diagnosis_has_ended(tmp_path):
    model, shown = tmp_path / "extended_model.json", []
    client = Client("effect 1", lambda ended: model.touch(), "write the report", ending(True))
    goal = RunningGoal(client, "diagnose", lambda feedback: shown.append(feedback.stage))
    assert goal.wait_until(model.exists)
    assert (shown, goal.stage) == (["effect 1"], "effect 1")
    client.spin_until(lambda: goal.stage == "write the report", 0.0)
    assert shown == ["effect 1"]  # whoever waits for another goal tells of that one
    assert goal.result().success


def test_a_goal_that_ends_before_has_failed():
    goal = RunningGoal(Client("effect 1", ending(False)), "diagnose", lambda feedback: None)
    assert not goal.wait_until(lambda: False)
    with pytest.raises(GoalFailed, match="diagnose: no recording"):
        goal.result()


class Resting:
    """A client of a stage that rests for 3 s each time, and of a monitor that meets it late."""

    def __init__(self, met_after):
        self.rests, self._met_after, self.waits = 0, met_after, []

    def goal(self, name, **fields):
        self.rests += 1

    def heard(self, message_type, topic, quality, enough, timeout_s):
        self.waits.append((self.rests, timeout_s))
        # Of a stage before, whose clock was further on.
        watched_s = 3.0 * self.rests if self.rests > self._met_after else 500.0
        if not self.rests:
            watched_s = 0.0
        told = KeyValue(key="watched_until_s", value=f"{watched_s + 0.001:.3f}")
        return [DiagnosticArray(status=[DiagnosticStatus(values=[told])])]


def session_of(client):
    processes = SimpleNamespace(log=lambda name: f"{name}.log")
    return Session(client, processes, {}, [1.0, 1.0], lambda: True, lambda step: None)


def test_a_monitor_that_misses_a_rest_is_met_at_the_next():
    client = Resting(met_after=1)
    session_of(client).let_monitor_follow()
    assert client.rests == MEETINGS  # the clock of the stage is the same in any case


def test_a_monitor_that_starts_is_waited_for_before_the_stage_rests():
    client = Resting(met_after=0)
    session_of(client).let_monitor_follow()
    assert client.waits[0] == (0, START_TIMEOUT_S)


def test_a_monitor_that_never_follows_is_told():
    with pytest.raises(RuntimeError, match="does not follow the stage; see monitor.log"):
        session_of(Resting(met_after=MEETINGS)).let_monitor_follow()
