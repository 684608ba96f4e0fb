# SPDX-License-Identifier: BSD-3-Clause
"""What the demo asks of running nodes beside or between its runs."""

from piezo_client.client import ALIVE_PERIOD_S, GoalFailed
from piezo_client.model_offers import monitor_follows

START_TIMEOUT_S = 60.0

MEETINGS = 3
"""Rests on a new stage while the monitor meets it."""
MEETING_S = 10.0
"""After each, for which it is waited for."""


def rest(client, voltage_v):
    """Have the stage play voltages of a second each, until it is at rest."""
    client.goal("play_waveform", voltage_v=voltage_v, sample_period_s=1.0, repeats=1)


class RunningGoal:
    """A goal that goes on beside others of the same client.

    Parameters
    ----------
    name : str
        Of the action.
    show : callable
        Called with each feedback message while this goal alone is waited for.
    **fields
        Of the goal.

    Attributes
    ----------
    stage : str
        Of the last feedback.
    """

    def __init__(self, client, name, show, **fields):
        self._client, self._name, self._show = client, name, show
        self._waits, self.stage = False, ""
        self._ended = client.send(name, self._tell, **fields).get_result_async()

    def _tell(self, feedback):
        self.stage = feedback.stage
        if self._waits:
            self._show(feedback)

    def wait_until(self, condition):
        """Wait until a condition holds; return whether it does, as the goal may end before."""
        self._waits = True
        while not self._client.spin_until(
                lambda: condition() or self._ended.done(), ALIVE_PERIOD_S):
            self._client.check()
        self._waits = False
        return condition()

    def result(self):
        """Return the result of the action, once it has ended.

        Raises
        ------
        GoalFailed
            If it failed.
        """
        self.wait_until(self._ended.done)
        message = self._ended.result().result
        if not message.success:
            raise GoalFailed(self._name, message)
        return message


class Session:
    """Running nodes, of which the stage can be started anew on another plant.

    Parameters
    ----------
    processes : piezo_bringup.processes.Processes
        With a running ``stage``.
    stage_parameters : dict
        Of the stage node, but for its plant.
    rest_v : sequence of float
        Voltages of a second each, before each run.
    is_active : callable
        Tells whether the stage is active.
    show : callable
        Called with what is done.
    """

    def __init__(self, client, processes, stage_parameters, rest_v, is_active, show):
        self.client, self.rest_v = client, rest_v
        self._processes, self._stage_parameters = processes, stage_parameters
        self._is_active, self._show = is_active, show

    @property
    def rest_s(self):
        """Return how long a rest takes: a sample more, in which the stage goes to its voltage."""
        return len(self.rest_v) + 1.0

    def start_stage(self, plant):
        """End the stage, and start it on a plant file; see `wait_for_stage`."""
        self._processes.stop(["stage"])
        self._processes.start("stage", {**self._stage_parameters, "plant": plant})

    def wait_for_stage(self):
        """Wait until the stage that was started is active.

        Raises
        ------
        RuntimeError
            If it is not active in time.
        """
        self._show("start the stage on another plant")
        if not self.client.spin_until(self._is_active, START_TIMEOUT_S):
            raise RuntimeError(f"the stage was not active within {START_TIMEOUT_S:g} s; "
                               f"see {self._processes.log('stage')}")

    def start_monitor(self, parameters):
        """Start the monitor; after the stage, so that it meets no other stage before."""
        self._processes.start("monitor", parameters)

    def let_monitor_follow(self):
        """Wait for the monitor, rest `MEETINGS` times, and wait until it follows the stage.

        The monitor meets a stage, and the model of the controller, some time after these start, and
        a run in lockstep may be over by then. Samples may still be lost on the way to it.

        Raises
        ------
        RuntimeError
            If it does not follow.
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
        """Rest, track a reference by the composite control, and return the result of the action."""
        self._show(f"track beside the monitor, {directory.name}")
        rest(self.client, self.rest_v)
        return self.client.track(reference, model, "composite", duration_s, directory)

    def decide(self, model, recording, directory, longest_s):
        """Diagnose a recording, and let one proposed recording decide; return the result."""
        return self.client.diagnose(
            model, [recording], directory, experiments=1, longest_s=longest_s,
            on_feedback=lambda feedback: self._show(f"decide, {feedback.stage}"))
