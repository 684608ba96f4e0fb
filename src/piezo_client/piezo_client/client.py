# SPDX-License-Identifier: BSD-3-Clause
"""Send goals to the suite's actions from a script, and wait for their results."""

import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from piezo_interfaces.action import Diagnose, Identify, PlayWaveform, RunExperiment, Track
from piezo_interfaces.msg import Reference, StageDescription
from rclpy.action.client import ClientGoalHandle
from rclpy.qos import QoSProfile
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from piezo_client.interrupts import HeldSignals
from piezo_client.paths import AnyPath, with_absolute_paths
from piezo_ros.deadlines import set_deadline
from piezo_ros.discovery import LONGEST_STANDSTILL_S, prepare_discovery
from piezo_ros.executor import make_executor, spin_once
from piezo_ros.heartbeat import Heartbeat
from piezo_ros.leaving import leave
from piezo_ros.messages import Message, MessageType
from piezo_ros.process_watch import ProcessWatch
from piezo_ros.requests.calls import may_be_repeated
from piezo_ros.requests.goals import GOAL, GoalState
from piezo_ros.requests.lost_answers import PatientActionClient
from piezo_ros.requests.servers import WORD_AFTER_S, Waiting, described_server
from piezo_ros.stage_runs.described_stage import DescribedStage

SERVER_TIMEOUT_S = 30.0
"""Time to wait for a server; some nodes of a stage start before the others."""
LOST_RESPONSE_S = 2.0
"""Time before a goal or a request is sent again; it doubles with each repetition."""
# A node that designs a controller responds late on a busy machine.
ACCEPTANCE_TIMEOUT_S = 60.0
CANCEL_TIMEOUT_S = 10.0
CALL_TIMEOUT_S = 120.0
# A node that ends may be gone before its response is read.
LAST_ANSWER_S = 1.0
DIAGNOSTICS_S = 5.0
"""Time to wait for diagnostics, which nodes publish every second."""
ALIVE_PERIOD_S = 1.0
WATCH_PERIOD_S = 0.2
ACTIONS = {
    "play_waveform": (PlayWaveform, "play_waveform"),
    "run_experiment": (RunExperiment, "identification/run_experiment"),
    "identify": (Identify, "identification/identify"),
    "diagnose": (Diagnose, "identification/diagnose"),
    "track": (Track, "controller/track"),
}


STATE_AFTER = {
    Transition.TRANSITION_CONFIGURE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_CLEANUP: State.PRIMARY_STATE_UNCONFIGURED,
    Transition.TRANSITION_ACTIVATE: State.PRIMARY_STATE_ACTIVE,
    Transition.TRANSITION_DEACTIVATE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_UNCONFIGURED_SHUTDOWN: State.PRIMARY_STATE_FINALIZED,
    Transition.TRANSITION_INACTIVE_SHUTDOWN: State.PRIMARY_STATE_FINALIZED,
    Transition.TRANSITION_ACTIVE_SHUTDOWN: State.PRIMARY_STATE_FINALIZED,
}
"""State of a lifecycle node after a transition, which leads from another state."""


class GoalFailed(RuntimeError):
    """An action ended without success; the text is the action's own."""

    def __init__(self, name: str, result: Message) -> None:
        super().__init__(f"{name}: {result.message}")
        self.result = result


class ServiceFailed(GoalFailed):
    """A service did not respond."""

    def __init__(self, text: str) -> None:
        RuntimeError.__init__(self, text)
        self.result = None


def nobody_serves(namespace: str) -> ServiceFailed:
    """Return the exception that says how to start the stage of a namespace."""
    return ServiceFailed(f"nobody serves {namespace.rstrip('/')}/stage: start it with "
                         "`./run piezo_bringup suite`, or check --namespace")


class StoodStill(ServiceFailed):
    """The process was suspended for so long that the nodes ended its goals."""

    def __init__(self, standstill_s: float) -> None:
        super().__init__(f"this process stood still for {standstill_s:.1f} s, and the nodes have "
                         "given it up: make a new client")


class Client:
    """A node that sends goals and calls services; a context manager.

    It looks for any node in the namespace for a time (s); if there is one, a server has
    `SERVER_TIMEOUT_S` to appear.
    """

    _signals = HeldSignals()  # shared by all clients of the process

    def __init__(self, namespace: str = "", name: str = "client",
                 wait_s: float = SERVER_TIMEOUT_S) -> None:
        self._wait_s = wait_s
        prepare_discovery()
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node(name, namespace=namespace, context=self._context)
        self._executor = make_executor(self._context)
        self._executor.add_node(self.node)
        self._heartbeat = Heartbeat()
        self._watch = ProcessWatch(self.node)
        self._actions = {
            name: PatientActionClient(self.node, action_type, topic)
            for name, (action_type, topic) in ACTIONS.items()}
        self._services: dict[tuple[MessageType, str], rclpy.client.Client] = {}
        self._running: str | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave ROS, and end its threads and waits."""
        self._heartbeat.end()
        self._watch.end()
        # Otherwise the executor keeps its wait set, and the stage a reader that does not respond.
        self._executor.remove_node(self.node)
        self._executor.shutdown()
        # At exit, Python would destroy these after the objects that they depend on.
        for client in self._actions.values():
            client.destroy()
        self._actions.clear()
        for service in self._services.values():
            self.node.destroy_client(service)
        self._services.clear()
        leave(self.node)

    def run_experiment(self, experiment: str, directory: AnyPath,
                       **options: Any) -> RunExperiment.Result:
        """Run and record one experiment; see `goal`."""
        return self.goal(
            "run_experiment", experiment=experiment, directory=directory, **options)

    def identify(self, directory: AnyPath, **options: Any) -> Identify.Result:
        """Run the whole identification; see `goal`."""
        return self.goal("identify", directory=directory, **options)

    def diagnose(self, model: AnyPath, recordings: Sequence[AnyPath], directory: AnyPath,
                 holdout: AnyPath = "", **options: Any) -> Diagnose.Result:
        """Find what a model lacks to explain recordings; see `goal`."""
        return self.goal(
            "diagnose", model=model, recordings=recordings, holdout=holdout,
            directory=directory, **options)

    def track(self, reference: Mapping[str, Any], model: AnyPath, mode: str, duration_s: float,
              directory: AnyPath, **options: Any) -> Track.Result:
        """Track a reference given as a dict of the fields of ``Reference``; see `goal`."""
        return self.goal(
            "track", reference=Reference(**reference), model=model, mode=mode,
            duration_s=float(duration_s), directory=directory, **options)

    def goal(self, name: str, on_feedback: Callable[[Message], object] | None = None,
             cancel_after_s: float | None = None, why_stop: Callable[[], str] | None = None,
             **fields: Any) -> Message:
        """Send a goal and wait for its end.

        Parameters
        ----------
        name : str
            One of `ACTIONS`.
        on_feedback : callable, optional
            Called with each feedback message; an exception that it raises cancels the goal.
        cancel_after_s : float, optional
            Time in s after which the goal is cancelled.
        why_stop : callable, optional
            Called periodically; a text that is not empty cancels the goal, which then fails with
            this text.
        **fields
            Fields of the goal; relative paths refer to the caller's folder. ``client`` is this node
            by default: the server cancels the goal once that node is gone.

        Raises
        ------
        GoalFailed
            If the goal was rejected, aborted or cancelled, or its server has ended.
        KeyboardInterrupt
            After the goal has been cancelled and the stage is at rest.
        """
        with self._signals.hold():
            return self._goal(name, on_feedback, cancel_after_s, why_stop, fields)

    def _goal(self, name: str, on_feedback: Callable[[Message], object] | None,
              cancel_after_s: float | None, why_stop: Callable[[], str] | None,
              fields: Mapping[str, Any]) -> Message:
        handle = self.send(name, on_feedback, **fields)
        result = handle.get_result_async()
        self._running = name
        try:
            if cancel_after_s is not None:
                self.spin_until(result.done, cancel_after_s)
                handle.cancel_goal_async()
            cause = why_stop and self._stop_if(why_stop, handle, result)
            cancelled = cause or cancel_after_s is not None
            message = self.wait(
                result, Waiting(self.node, ACTIONS[name][1]) if cancelled else None).result
            if cause:
                message.success, message.message = False, cause
        except GoalFailed:
            raise
        except BaseException:  # Ctrl-C, or an exception of on_feedback
            self._cancel(handle, result, ACTIONS[name][1])
            raise
        finally:
            self._running = None
        if not message.success:
            raise GoalFailed(name, message)
        return message

    def _stop_if(self, why_stop: Callable[[], str], handle: ClientGoalHandle,
                 result: Future) -> str:
        """Wait for the end of a goal, or cancel it for a cause; return the cause or ''."""
        while not self.spin_until(result.done, WATCH_PERIOD_S):
            self.check()
            if cause := why_stop():
                handle.cancel_goal_async()
                return cause
        return ""

    def send(self, name: str, on_feedback: Callable[[Message], object] | None = None,
             **fields: Any) -> ClientGoalHandle:
        """Send a goal and return its handle without waiting for the end.

        Raises `GoalFailed` if there is no server, or it rejected the goal.
        """
        action_type, topic = ACTIONS[name]
        client = self._actions[name]
        self._await(client.server_is_ready, topic)
        goal = action_type.Goal(
            **{"client": self.node.get_fully_qualified_name(), **with_absolute_paths(fields)})
        set_deadline(goal, ACCEPTANCE_TIMEOUT_S)
        number = UUID(uuid=list(uuid.uuid4().bytes))

        def ask() -> Future:
            # The same number for every attempt: if only the response was lost, the goal acts once.
            return client.send_goal_async(goal, pass_on, number)

        def pass_on(message: Message) -> None:
            nonlocal on_feedback
            callback, on_feedback = on_feedback, None
            if callback is not None:
                callback(message.feedback)
                on_feedback = callback  # not called again after it raised

        sent: list[Future] = []
        with self._signals.hold():
            try:
                handle = self._accepted(client, topic, sent, ask)
            except GoalFailed:
                raise
            except BaseException:
                if sent:  # the goal may have been accepted and must not run on alone
                    self._withdraw(client, number, action_type, topic)
                raise
        if handle is None:
            self._withdraw(client, number, action_type, topic)
            raise GoalFailed(name, action_type.Result(message=(
                f"{self._server(topic)} did not report whether it took the goal: see its log, "
                "send the goal again")))
        if not handle.accepted:
            raise GoalFailed(name, action_type.Result(message=(
                f"the node that serves {topic} rejected the goal: "
                f"{self._why_rejected(topic)}")))
        return handle

    def _why_rejected(self, topic: str) -> str:
        """Return what the server of an action reports about its present goal.

        The rejection itself contains no reason.
        """
        server = f"{self.node.get_namespace().rstrip('/')}/{topic.partition('/')[0]}"

        def of_goal(messages: list[Message]) -> list[DiagnosticStatus]:
            return [status for message in messages for status in message.status
                    if status.name == f"{server}: goal"]

        reported = of_goal(self.heard(DiagnosticArray, "/diagnostics", 10, of_goal, DIAGNOSTICS_S))
        if reported and KeyValue(key=GOAL, value=str(GoalState.NONE)) not in reported[-1].values:
            return f"it is {reported[-1].message}"
        return "it is busy with another goal or not active, its log states which"

    def _accepted(self, client: PatientActionClient, topic: str, sent: list[Future],
                  ask: Callable[[], Future]) -> ClientGoalHandle | None:
        """Send a goal, repeatedly if necessary; return the handle, or None without a response."""
        def settled() -> bool:
            return (any(answer.done() and answer.result().accepted for answer in sent)
                    or all(answer.done() for answer in sent))

        begun_s, wait_s = time.monotonic(), LOST_RESPONSE_S
        waiting = Waiting(self.node, topic)
        while (waited_s := time.monotonic() - begun_s) < ACCEPTANCE_TIMEOUT_S:
            waiting.look(waited_s)
            sent.append(ask())
            if not self.spin_until(settled, min(wait_s, ACCEPTANCE_TIMEOUT_S - waited_s)):
                client.settle()
            wait_s = min(2.0 * wait_s, WORD_AFTER_S)
            if settled():
                handles = [answer.result() for answer in sent if answer.done()]
                return max(handles, key=lambda handle: handle.accepted)
            if not client.server_is_ready():  # a restarted node has not appeared yet
                self._await(client.server_is_ready, topic)
        return None

    def _withdraw(self, client: PatientActionClient, number: UUID, action_type: MessageType,
                  topic: str) -> None:
        """Cancel a goal that may be running; wait for its end if it is."""
        handle = ClientGoalHandle(
            client, number, action_type.Impl.SendGoalService.Response(accepted=True))
        self._cancel(handle, handle.get_result_async(), topic)

    def _cancel(self, handle: ClientGoalHandle, result: Future, topic: str) -> None:
        """Cancel a goal; wait for its end for a limited time."""
        handle.cancel_goal_async()
        waiting, begun_s = Waiting(self.node, topic), time.monotonic()
        while not self.spin_until(result.done, ALIVE_PERIOD_S):
            waited_s = time.monotonic() - begun_s
            waiting.look(waited_s)
            if waited_s > CANCEL_TIMEOUT_S:
                self.node.get_logger().error(
                    f"{self._server(topic)} has not ended the goal within {CANCEL_TIMEOUT_S:g} s "
                    "of its being cancelled: look whether the stage is at rest, or stop it")
                return

    def call(self, service_type: MessageType, name: str, /, **fields: Any) -> Message:
        """Call a service and return its response.

        The request is sent again if no response comes and a repetition does no harm: a request with
        a number acts once for its number, and a transition of a lifecycle node leads from one state
        only. Raises `ServiceFailed` if there is no server, or its node ends before it responds.
        """
        with self._signals.hold():
            # A server may respond to a new client before discovery is complete: the response is
            # lost.
            client = self._services.get((service_type, name))
            if client is None:
                client = self.node.create_client(service_type, name)
                self._services[service_type, name] = client
            self._await(client.service_is_ready, name)
            request = service_type.Request(**with_absolute_paths(fields))
            set_deadline(request, CALL_TIMEOUT_S)
            return self._answer(client, name, request)

    def _answer(self, client: rclpy.client.Client, name: str, request: Message) -> Message:
        leads_to = (STATE_AFTER.get(request.transition.id)
                    if isinstance(request, ChangeState.Request) else None)
        repeatable = leads_to is not None or may_be_repeated(request)
        answers = [client.call_async(request)]

        def answered() -> bool:
            return any(answer.done() for answer in answers)

        waiting = Waiting(self.node, name)
        begun_s = sent_s = time.monotonic()
        resend_s = LOST_RESPONSE_S
        while not self.spin_until(answered, ALIVE_PERIOD_S):
            now_s = time.monotonic()
            if not (client.service_is_ready() or self.spin_until(answered, LAST_ANSWER_S)):
                raise ServiceFailed(f"the node that serves {name} has ended: start it again")
            if now_s - begun_s > CALL_TIMEOUT_S:
                raise ServiceFailed(f"{self._server(name)} did not answer {name} within "
                                    f"{CALL_TIMEOUT_S:g} s: look at its log")
            waiting.look(now_s - begun_s)
            if repeatable and now_s - sent_s > resend_s:
                sent_s, resend_s = now_s, 2.0 * resend_s
                answers.append(client.call_async(request))
        response = next(answer for answer in answers if answer.done()).result()
        if leads_to is not None and len(answers) > 1 and not response.success:
            # A repetition is refused if the first request acted and its response was lost.
            state = self.call(GetState, f"{name.rpartition('/')[0]}/get_state").current_state
            response.success = state.id == leads_to
        return response

    def _await(self, ready: Callable[[], bool], name: str) -> None:
        """Wait for the server of a name; longer if there are other nodes in the namespace."""
        if self._appears(ready, name, min(self._wait_s, SERVER_TIMEOUT_S)):
            return
        if not self.neighbours():
            raise nobody_serves(self.node.get_namespace())
        if not self._appears(ready, name, max(SERVER_TIMEOUT_S - self._wait_s, 0.0)):
            raise ServiceFailed(f"nobody serves {name}: start its node")

    def _appears(self, ready: Callable[[], bool], name: str, timeout_s: float) -> bool:
        """Wait for the server of a name, and log while there is none."""
        waiting, begun_s, waited_s = Waiting(self.node, name), time.monotonic(), 0.0
        while not self.spin_until(ready, min(timeout_s - waited_s, WORD_AFTER_S)):
            waited_s = time.monotonic() - begun_s
            if waited_s >= timeout_s:
                return False
            waiting.look(waited_s)
        return True

    def _server(self, name: str) -> str:
        """Return the node that serves a name, or a description of it."""
        return described_server(self.node, name)

    def description(self, stage: DescribedStage) -> StageDescription:
        """Return the description that a stage publishes; wait for it as for a server."""
        self._await(lambda: stage.description is not None, stage.topic)
        description = stage.description
        if description is None:
            raise ServiceFailed(f"the stage that {stage.topic} described is gone: start it again")
        return description

    def neighbours(self) -> set[str]:
        """Return the names of the nodes in the namespace, except clients."""
        own = self.node.get_namespace()
        return {name for name, namespace in self.node.get_node_names_and_namespaces()
                if namespace == own and not name.startswith(("_", "client"))
                and name != self.node.get_name()}

    def wait(self, future: Future, waiting: Waiting | None = None) -> Message:
        """Spin until a future is done; return its result. `waiting` logs the wait."""
        begun_s = time.monotonic()
        while not self.spin_until(future.done, ALIVE_PERIOD_S):
            self.check()
            if waiting:
                waiting.look(time.monotonic() - begun_s)
        return future.result()

    def check(self) -> None:
        """Raise GoalFailed if the server of the present goal has ended."""
        if not self._running:
            return
        if not self._actions[self._running].server_is_ready():
            action_type, topic = ACTIONS[self._running]
            raise GoalFailed(self._running, action_type.Result(
                message=f"the node that serves {topic} has ended: start it again"))
        self._actions[self._running].ask_again()

    def heard(self, message_type: MessageType, topic: str, quality: QoSProfile | int,
              enough: Callable[[list[Message]], object], timeout_s: float) -> list[Message]:
        """Return the messages of a topic that come until they are enough or the time is up."""
        messages: list[Message] = []
        subscription = self.node.create_subscription(
            message_type, topic, messages.append, quality)
        try:
            self.spin_until(lambda: bool(enough(messages)), timeout_s)
        finally:
            self.node.destroy_subscription(subscription)
        return messages

    def spin_until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Spin until a condition holds or the time is up; return whether it holds.

        Raises `StoodStill` if this process was suspended, as by Ctrl-Z, for so long that the nodes
        ended its goals, and KeyboardInterrupt after Ctrl-C, once the present message has been
        processed.
        """
        deadline = time.monotonic() + timeout_s
        with self._signals.hold():
            while not condition():
                if time.monotonic() > deadline:
                    return False
                spin_once(self._executor, 0.05)
                self._signals.act()
                standstill_s = self._heartbeat.standstill_s()
                if standstill_s > LONGEST_STANDSTILL_S:
                    raise StoodStill(standstill_s)
        return True
