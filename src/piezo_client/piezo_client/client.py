# SPDX-License-Identifier: BSD-3-Clause
"""Ask the suite's actions from a script, and wait for what they return."""

import time

import rclpy
from piezo_interfaces.action import Diagnose, Identify, PlayWaveform, RunExperiment, Track
from piezo_interfaces.msg import Reference
from rclpy.action import ActionClient
from rclpy.experimental import EventsExecutor

from piezo_client.paths import with_absolute_paths
from piezo_node_tools.discovery import prepare_discovery

SERVER_TIMEOUT_S = 30.0
LOST_RESPONSE_S = 10.0
CANCEL_TIMEOUT_S = 10.0
ALIVE_PERIOD_S = 1.0
ACTIONS = {
    "play_waveform": (PlayWaveform, "play_waveform"),
    "run_experiment": (RunExperiment, "identification/run_experiment"),
    "identify": (Identify, "identification/identify"),
    "diagnose": (Diagnose, "identification/diagnose"),
    "track": (Track, "controller/track"),
}


class GoalFailed(RuntimeError):
    """An action ended without success; the text is the action's own."""

    def __init__(self, name, result):
        super().__init__(f"{name}: {result.message}")
        self.result = result


class Client:
    """A node of its own that sends goals and calls services; a context manager.

    Parameters
    ----------
    namespace : str
        Of the stage that is meant.
    name : str
        Of the node.
    """

    def __init__(self, namespace="", name="client"):
        prepare_discovery()
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node(name, namespace=namespace, context=self._context)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._actions = {
            name: ActionClient(self.node, action_type, topic)
            for name, (action_type, topic) in ACTIONS.items()}
        self._running = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """Leave ROS."""
        # Without this the executor keeps what it waits on, and the stage a reader that hangs.
        self._executor.remove_node(self.node)
        self._executor.shutdown()
        # Left to the end of Python, these would be destroyed after what they stand on.
        for client in self._actions.values():
            client.destroy()
        self._actions.clear()
        self.node.destroy_node()
        self._context.try_shutdown()

    def run_experiment(self, experiment, directory, **options):
        """Run and record one experiment; see `goal`."""
        return self.goal(
            "run_experiment", experiment=experiment, directory=directory, **options)

    def identify(self, directory, **options):
        """Run the whole identification; see `goal`."""
        return self.goal("identify", directory=directory, **options)

    def diagnose(self, model, recordings, directory, holdout="", **options):
        """Find what a model lacks to explain recordings; see `goal`."""
        return self.goal(
            "diagnose", model=model, recordings=recordings, holdout=holdout,
            directory=directory, **options)

    def track(self, reference, model, mode, duration_s, directory, **options):
        """Track a reference given as a dict of the fields of ``Reference``; see `goal`."""
        return self.goal(
            "track", reference=Reference(**reference), model=model, mode=mode,
            duration_s=float(duration_s), directory=directory, **options)

    def goal(self, name, on_feedback=None, cancel_after_s=None, **fields):
        """Send a goal and wait for its end.

        Parameters
        ----------
        name : str
            One of `ACTIONS`.
        on_feedback : callable, optional
            Called with each feedback message.
        cancel_after_s : float, optional
            Cancel the goal after this time.
        **fields
            Of the goal; relative paths are of the caller's folder.

        Returns
        -------
        result : message

        Raises
        ------
        GoalFailed
            If the goal was refused, aborted or cancelled, or nobody serves the action any more.
        KeyboardInterrupt
            Once the goal has been cancelled and the stage is back at rest.
        """
        handle = self.send(name, on_feedback, **fields)
        result = handle.get_result_async()
        self._running = name
        try:
            if cancel_after_s is not None:
                self.spin_until(result.done, cancel_after_s)
                handle.cancel_goal_async()
            message = self.wait(result).result
        except KeyboardInterrupt:
            self._cancel(handle, result)
            raise
        finally:
            self._running = None
        if not message.success:
            raise GoalFailed(name, message)
        return message

    def send(self, name, on_feedback=None, **fields):
        """Send a goal and return its handle without waiting for the end."""
        action_type, topic = ACTIONS[name]
        client = self._actions[name]
        if not self.spin_until(client.server_is_ready, SERVER_TIMEOUT_S):
            raise GoalFailed(name, action_type.Result(
                message=f"nobody serves {topic}: start its node"))

        def ask():
            return client.send_goal_async(
                action_type.Goal(**with_absolute_paths(fields)),
                feedback_callback=lambda m: on_feedback(m.feedback) if on_feedback else None)

        sent = ask()
        try:
            if not self.spin_until(sent.done, LOST_RESPONSE_S):
                sent = ask()  # as in `call`
            return self.wait(sent)
        except KeyboardInterrupt:
            # The goal is on its way, and must not run on alone.
            if self.spin_until(sent.done, CANCEL_TIMEOUT_S):
                self._cancel(sent.result(), sent.result().get_result_async())
            raise

    def _cancel(self, handle, result):
        """Cancel a goal; wait for its end."""
        handle.cancel_goal_async()
        self.spin_until(result.done, CANCEL_TIMEOUT_S)

    def call(self, service_type, name, /, **fields):
        """Call a service and return its response."""
        client = self.node.create_client(service_type, name)
        if not self.spin_until(client.service_is_ready, SERVER_TIMEOUT_S):
            raise RuntimeError(f"nobody serves {name}: start its node")
        request = service_type.Request(**with_absolute_paths(fields))
        answer = client.call_async(request)
        if not self.spin_until(answer.done, LOST_RESPONSE_S):
            # A response gets lost where the server has not met the client yet: ask once more.
            answer = client.call_async(request)
        response = self.wait(answer)
        self.node.destroy_client(client)
        return response

    def wait(self, future):
        """Spin until a future is done; return its result."""
        while not self.spin_until(future.done, ALIVE_PERIOD_S):
            self.check()
        return future.result()

    def check(self):
        """Raise GoalFailed if the node that works on the present goal has ended."""
        if self._running and not self._actions[self._running].server_is_ready():
            action_type, topic = ACTIONS[self._running]
            raise GoalFailed(self._running, action_type.Result(
                message=f"the node that serves {topic} has ended: start it again"))

    def spin_until(self, condition, timeout_s):
        """Spin until a condition holds or time is up; return whether it holds."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                return False
            self._executor.spin_once(timeout_sec=0.05)
        return True
