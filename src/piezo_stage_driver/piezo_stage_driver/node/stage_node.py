# SPDX-License-Identifier: BSD-3-Clause
"""The stage as a lifecycle node: one interface over every backend."""

import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus
from piezo_interfaces.msg import FeedbackVoltage
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from piezo_ros.clock_guard import keep_clock
from piezo_ros.parameters import declare
from piezo_ros.presence import ClientWatch
from piezo_ros.quality import FEEDBACK
from piezo_ros.spinning import autostart, run_node
from piezo_stage_driver.backends.backend import BackendFault
from piezo_stage_driver.backends.registry import create_backend
from piezo_stage_driver.engine.answer_latency import AnswerLatency
from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.node.stage_outputs import StageOutputs
from piezo_stage_driver.node.stage_services import StageServices
from piezo_stage_driver.node.stage_settings import StageSettings
from piezo_stage_driver.node.waveform_goals import WaveformGoals
from piezo_stage_driver.safety.guards import StopLatch
from piezo_stage_driver.safety.supervisor import NOT_ACTIVE, UNSAFE
from piezo_stage_driver.safety.transitions import State

IDLE_WAIT_S = 0.05
WATCH_PERIOD_S = 0.1
CLIENT_WATCH_PERIOD_S = 0.2
DIAGNOSTICS_PERIOD_S = 1.0
FEEDBACK_WARNING_PERIOD_S = 1.0


class StageNode(LifecycleNode):
    """Publish what the stage measures, play what it is sent, within its limits.

    With ``timing`` *paced* the backend's clock drives the stage in a thread of its own.
    With *lockstep* stage time passes only while something plays, and each tick that
    needs an answer waits for it; results then do not depend on the machine's speed.

    Parameters
    ----------
    create_backend : callable
        Takes the node, returns a ``StageBackend``; called when the node is configured.

    Attributes
    ----------
    settings : StageSettings
        The node's parameters.
    """

    def __init__(self, create_backend):
        super().__init__("stage")
        self._create_backend = create_backend
        self.settings = StageSettings(self)
        self._outputs = StageOutputs(self, self.settings)
        self._latch = StopLatch()
        self._latency = AnswerLatency()
        self._backend = self._supervisor = self._loop = self._failure = self._own_rest = None
        self._leaving = False
        self._told_cause = ""
        self._answer_deadline = None
        self._client_watch = ClientWatch(self)
        self._goals = WaveformGoals(self, self.submit)
        self._client_services = StageServices(self, self.settings.emergency_stop_timeout_s)
        feedback = self.create_subscription(
            FeedbackVoltage, "feedback", self._on_feedback, FEEDBACK)
        self._feedback_topic = feedback.topic_name
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(WATCH_PERIOD_S, self._watch, clock=clock)
        self.create_timer(CLIENT_WATCH_PERIOD_S, self._watch_client, clock=clock)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=clock)
        keep_clock(self, lambda: "the stage is active" if self._active else "")
        autostart(self, default=False)

    # Lifecycle

    def on_configure(self, state):
        """Make the backend and check the limits."""
        try:
            self._backend = self._create_backend(self)
            self._supervisor = self.settings.create_supervisor(self._backend, self._latch)
        except ValueError as error:
            self.get_logger().error(f"cannot configure: {error}")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state):
        """Start the sample clock at sample 0."""
        try:
            self._supervisor.activate()
        except (ValueError, OSError, BackendFault) as error:
            self.get_logger().error(f"cannot activate: {error}")
            return TransitionCallbackReturn.FAILURE
        self._outputs.epoch_ns = (
            0 if self.settings.lockstep else self.get_clock().now().nanoseconds)
        self._latency = AnswerLatency()
        self._failure = self._own_rest = None
        self._leaving = False
        if not self.settings.lockstep:
            # A daemon: a backend that never returns must not keep the process from its end.
            self._loop = threading.Thread(target=self._run_paced, name="stage loop", daemon=True)
            self._loop.start()
        return super().on_activate(state)

    def on_deactivate(self, state):
        """Return to rest and stop the sample clock."""
        self._leave_active("the stage was deactivated")
        return super().on_deactivate(state)

    def on_cleanup(self, state):
        """Let the backend go."""
        self._backend = self._supervisor = None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state):
        """Return to rest from any state."""
        self._leave_active("the stage was shut down")
        return TransitionCallbackReturn.SUCCESS

    def wind_down(self):
        """Return to rest; return whether the client of what was played knows."""
        self._leave_active("the stage node was ended")
        return self._goals.answered

    def close(self):
        """Let subscribers have the last samples before the process ends."""
        self._outputs.wait_for_delivery()

    def _leave_active(self, cause):
        supervisor = self._supervisor
        if supervisor is None:
            return
        self._leaving = True
        supervisor.leave(cause)
        while supervisor.active:
            if self._loop is None or not self._loop.is_alive():
                self._advance()
                continue
            self._loop.join(IDLE_WAIT_S)
            if supervisor.hangs:
                self._rest_without_loop(cause)
        if not supervisor.hangs and self._loop is not None:
            self._loop.join()
        self._loop = None
        supervisor.leave(cause)
        self._client_services.settle()

    def _rest_without_loop(self, cause):
        """Give up a backend that hangs while the stage is left."""
        self._begin_own_rest()
        if self._own_rest is not None:
            self._own_rest.join(self.settings.exchange_timeout_s)
        self._supervisor.give_up(
            f"{cause} while its backend hung: cut the amplifier's supply")

    # Time

    def step(self):
        """Advance a lockstep stage; return how long to wait for the next callback (s)."""
        if self._failure is not None:
            raise self._failure
        supervisor = self._supervisor
        if supervisor is None:
            return IDLE_WAIT_S
        if supervisor.state is State.FAULTED:
            self._tell_stop()
            self.trigger_deactivate()
            self._publish_diagnostics()
        if not self.settings.lockstep or not supervisor.has_work:
            return IDLE_WAIT_S
        if supervisor.engine.awaiting_answer:
            now = time.monotonic()
            if self._answer_deadline is None:
                self._answer_deadline = now + self.settings.lockstep_timeout_s
            if now < self._answer_deadline:
                return min(IDLE_WAIT_S, self._answer_deadline - now)
        self._answer_deadline = None
        self._advance()
        return 0.0

    def _run_paced(self):
        try:
            while self._supervisor.active:
                self._advance()
        except Exception as error:  # whatever it is: the main thread sees to it
            self._failure = error

    def _advance(self):
        supervisor = self._supervisor
        was_idle = supervisor.engine.idle
        self._publish(supervisor.tick())
        self._tell_stop()
        if self.settings.lockstep and supervisor.engine.idle and not was_idle:
            # Time stands still from here on: the last block, at rest, tells that all is over.
            for _ in range(supervisor.engine.lead_ticks + 1):
                self._publish(supervisor.tick())
        self._client_services.settle()

    def on_block(self, block):
        """Take part when a block is published; for stages that know more than they measure."""

    def _publish(self, block):
        if block is None:
            return
        self._latency.published(block.tick)
        self._outputs.publish_block(block, self._engine.next_sample, self._engine.idle)
        self.on_block(block)

    # Commands

    @property
    def _engine(self):
        return self._supervisor.engine if self._supervisor else None

    @property
    def _active(self):
        return self._supervisor is not None and self._supervisor.active and not self._leaving

    @property
    def at_rest(self):
        """Whether the amplifier is known to be at rest; it is before anything was configured."""
        return self._supervisor is None or self._supervisor.at_rest

    @property
    def can_come_to_rest(self):
        """Whether the stage still drives the amplifier."""
        return self._supervisor is not None and self._supervisor.active

    @property
    def seconds_to_rest(self):
        """What a return to rest would take from here (s)."""
        return self._engine.seconds_to_rest if self.can_come_to_rest else 0.0

    def submit(self, command):
        """Have a command run between two ticks, or refused; it tells by itself which."""
        if self._supervisor is not None:
            self._supervisor.submit(command)
            if self.settings.lockstep:
                self._supervisor.attend()
        elif command.name == "reset":
            self._latch.reset()
            command.finish()
        else:
            command.finish(error=StageRefusal(NOT_ACTIVE))

    def stop(self, cause):
        """Stop from whatever state, until somebody resets it."""
        if self._supervisor is not None:
            self._supervisor.stop(cause)
        self._latch.stop(cause)
        self._tell_stop()

    # Watching

    def _watch(self):
        supervisor = self._supervisor
        if supervisor is None:
            return
        supervisor.watch()
        if supervisor.hangs:
            self._begin_own_rest()
        self._tell_stop()
        self._client_services.settle()

    def _begin_own_rest(self):
        """Ask a backend that hangs for its own way to rest, if it has one, and once."""
        if self._own_rest is None and hasattr(self._backend, "emergency_rest"):
            self._own_rest = threading.Thread(
                target=self._rest_by_backend, name="own rest", daemon=True)
            self._own_rest.start()

    def _rest_by_backend(self):
        try:
            self._backend.emergency_rest()
        except Exception as error:  # of a vendor's library
            self._supervisor.give_up(f"the backend hangs, and cannot come to rest: {error}")
        else:
            self._supervisor.give_up("the backend hung, and came to rest in its own way",
                                     at_rest=True)

    def _watch_client(self):
        client = self._engine.client if self._active else ""
        if self._client_watch.is_gone(client):
            self.stop(f"the client {client} is gone")

    def _tell_stop(self):
        """Say it where the stage has been stopped since; called from both threads."""
        cause, told = self._latch.cause, self._told_cause
        self._told_cause = cause
        if cause and cause != told:
            self.get_logger().error(f"stopped: {cause}")
            self._publish_diagnostics()

    def _publish_diagnostics(self):
        supervisor = self._supervisor
        engine = self._engine
        if self._latch.cause:
            level, message = DiagnosticStatus.ERROR, self._latch.cause
        elif not self._active:
            level, message = DiagnosticStatus.OK, "not active"
        elif engine.missed_feedback:
            level, message = DiagnosticStatus.WARN, "feedback answers were missed"
        else:
            level, message = DiagnosticStatus.OK, engine.phase_name
        if supervisor is not None and (supervisor.hangs or not (
                supervisor.active or supervisor.at_rest)):
            level, message = DiagnosticStatus.ERROR, f"{message}; {UNSAFE}"
        values = {} if supervisor is None else {
            "phase": engine.phase_name if self._active else "not active",
            "client": engine.client,
            "voltage_v": f"{engine.voltage_v:.4f}", "next_sample": engine.next_sample,
            "missed_feedback": engine.missed_feedback, **supervisor.described,
            **self._latency.described()}
        self._outputs.publish_diagnostics(level, message, values)

    def _on_feedback(self, message):
        if not self._active:
            return
        self._latency.answered(message.tick)
        try:
            self._supervisor.answer(
                message.tick, message.voltage_v, message.run, self._one_node_answers)
        except ValueError as error:
            self.get_logger().warning(f"feedback refused: {error}",
                                      throttle_duration_sec=FEEDBACK_WARNING_PERIOD_S)
            self._tell_stop()

    def _one_node_answers(self):
        return self.count_publishers(self._feedback_topic) <= 1


def main(args=None):
    """Run the node ``stage`` over the backend that its parameters name."""
    run_node(lambda: StageNode(_chosen_backend), args)


def _chosen_backend(node):
    name = declare(node, "backend", "nidaqmx", "Name of the backend, such as nidaqmx.")
    file = declare(node, "backend_file", "", "Settings of the backend, such as its calibration.")
    return create_backend(name, node.settings.for_backend(file))
