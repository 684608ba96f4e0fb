# SPDX-License-Identifier: BSD-3-Clause
"""Requests of the demo to running nodes, during or between its runs."""

from piezo_client.client import ALIVE_PERIOD_S, GoalFailed
from piezo_client.model_offers import monitor_follows

START_TIMEOUT_S = 60.0

MEETINGS = 3
"""Number of rests on a new stage while the monitor connects to it."""
MEETING_S = 10.0
"""Longest wait for the monitor after each rest (s)."""


def rest(client, voltage_v):
    """Play voltages for a second each, so that the stage comes to rest."""
    client.goal("play_waveform", voltage_v=voltage_v, sample_period_s=1.0, repeats=1)


class RunningGoal:
    """A goal that runs in parallel with others of the same client.

    Its `stage` is that of the last feedback. Each feedback is shown while this goal is waited for.
    """

    def __init__(self, client, name, show, **fields):
        self._client, self._name, self._show = client, name, show
        self._waits, self.stage = False, ""
        self._ended = client.send(name, self._report, **fields).get_result_async()

    def _report(self, feedback):
        self.stage = feedback.stage
        if self._waits:
            self._show(feedback)

    def wait_until(self, condition):
        """Wait until a condition holds or the goal ends; return whether the condition holds."""
        self._waits = True
        while not self._client.spin_until(
                lambda: condition() or self._ended.done(), ALIVE_PERIOD_S):
            self._client.check()
        self._waits = False
        return condition()

    def result(self):
        """Wait for the end of the action, and return its result; raise GoalFailed if it failed."""
        self.wait_until(self._ended.done)
        message = self._ended.result().result
        if not message.success:
            raise GoalFailed(self._name, message)
        return message


class Session:
    """Running nodes; the stage can be restarted with another plant.

    All other parameters of the stage stay the same. Before each run the stage rests at each of the
    voltages `rest_v` for a second.
    """

    def __init__(self, client, processes, stage_parameters, rest_v, is_active, show):
        self.client, self.rest_v = client, rest_v
        self._processes, self._stage_parameters = processes, stage_parameters
        self._is_active, self._show = is_active, show

    @property
    def rest_s(self):
        """Duration of a rest (s); it includes one more sample to reach the voltage."""
        return len(self.rest_v) + 1.0

    def start_stage(self, plant):
        """Restart the stage with a plant file; see `wait_for_stage`."""
        self._processes.stop(["stage"])
        self._processes.start("stage", {**self._stage_parameters, "plant": plant})

    def wait_for_stage(self):
        """Wait until the restarted stage is active; RuntimeError if it is not in time."""
        self._show("start the stage on another plant")
        if not self.client.spin_until(self._is_active, START_TIMEOUT_S):
            raise RuntimeError(f"the stage was not active within {START_TIMEOUT_S:g} s; "
                               f"see {self._processes.log('stage')}")

    def start_monitor(self, parameters):
        """Start the monitor; call it after `start_stage`, so that it finds the new stage."""
        self._processes.start("monitor", parameters)

    def let_monitor_follow(self):
        """Wait for the monitor, rest `MEETINGS` times, and wait until it follows the stage.

        The monitor discovers the stage and the model of the controller some time after their start,
        when a run in lockstep may already be over. Samples may also be lost on the way to it.
        RuntimeError is raised if it does not follow.
        """
        self._show("wait for the monitor")
        follows = False
        monitor_follows(self.client, 0.0, 1.0, START_TIMEOUT_S)
        for number in range(1, MEETINGS + 1):
            rest(self.client, self.rest_v)
            end_s = number * self.rest_s
            follows = follows or monitor_follows(self.client, end_s, end_s + 1.0, MEETING_S)
        if not follows:
            raise RuntimeError(
                f"the monitor does not follow the stage; see {self._processes.log('monitor')}")

    def track(self, reference, model, duration_s, directory):
        """Rest, track a reference with composite control, and return the result of the action."""
        self._show(f"track while the monitor watches, {directory.name}")
        rest(self.client, self.rest_v)
        return self.client.track(reference, model, "composite", duration_s, directory)

    def decide(self, model, recording, directory, longest_s):
        """Diagnose a recording with one proposed experiment, and return the result."""
        return self.client.diagnose(
            model, [recording], directory, experiments=1, longest_s=longest_s,
            on_feedback=lambda feedback: self._show(f"decide, {feedback.stage}"))
