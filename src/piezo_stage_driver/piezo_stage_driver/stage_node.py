# SPDX-License-Identifier: BSD-3-Clause
"""The stage as a lifecycle node: one interface over every backend."""

import queue
import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus
from piezo_interfaces.msg import FeedbackVoltage
from piezo_interfaces.srv import LoadFeedforward, StartTracking
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from std_srvs.srv import Trigger

from piezo_node_tools.clock_guard import keep_clock
from piezo_node_tools.parameters import declare
from piezo_node_tools.presence import ClientWatch
from piezo_node_tools.quality import FEEDBACK
from piezo_node_tools.spinning import autostart, run_node
from piezo_stage_driver.backend import BackendFault
from piezo_stage_driver.backends import create_backend
from piezo_stage_driver.guards import StopLatch
from piezo_stage_driver.latency import AnswerLatency
from piezo_stage_driver.stage_outputs_node import StageOutputs
from piezo_stage_driver.stage_settings_node import StageSettings
from piezo_stage_driver.waveform_goals_node import WaveformGoals

IDLE_WAIT_S = 0.05
COMMAND_TIMEOUT_S = 5.0
CLIENT_WATCH_PERIOD_S = 0.2
DIAGNOSTICS_PERIOD_S = 1.0


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
        self._backend = self._engine = self._loop = self._failure = None
        self._commands = queue.SimpleQueue()
        self._active = False
        self._answer_deadline = None
        self._client_watch = ClientWatch(self)
        self._goals = WaveformGoals(self, self._command)
        self.create_subscription(FeedbackVoltage, "feedback", self._on_feedback, FEEDBACK)
        self.create_service(LoadFeedforward, "load_feedforward", self._on_load_feedforward)
        self.create_service(StartTracking, "start_tracking", self._on_start_tracking)
        self.create_service(Trigger, "stop_tracking", self._on_stop_tracking)
        self.create_service(Trigger, "emergency_stop", self._on_emergency_stop)
        self.create_service(Trigger, "reset", self._on_reset)
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(CLIENT_WATCH_PERIOD_S, self._watch_client, clock=clock)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=clock)
        keep_clock(self, lambda: "the stage is active" if self._active else "")
        autostart(self, default=False)

    # Lifecycle

    def on_configure(self, state):
        """Make the backend and check the limits."""
        try:
            self._backend = self._create_backend(self)
            self._engine = self.settings.create_engine(self._backend, self._latch)
        except ValueError as error:
            self.get_logger().error(f"cannot configure: {error}")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state):
        """Start the sample clock at sample 0."""
        try:
            self._backend.open()
        except (ValueError, OSError, BackendFault) as error:
            self.get_logger().error(f"cannot activate: {error}")
            return TransitionCallbackReturn.FAILURE
        self._engine = self.settings.create_engine(self._backend, self._latch)
        self._outputs.epoch_ns = (
            0 if self.settings.lockstep else self.get_clock().now().nanoseconds)
        self._latency = AnswerLatency()
        self._failure = None
        self._active = True
        if not self.settings.lockstep:
            self._loop = threading.Thread(target=self._run_paced, name="stage loop")
            self._loop_ends = False
            self._loop.start()
        return super().on_activate(state)

    def on_deactivate(self, state):
        """Return to rest and stop the sample clock."""
        self._leave_active("the stage was deactivated")
        return super().on_deactivate(state)

    def on_cleanup(self, state):
        """Let the backend go."""
        self._backend = self._engine = None
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
        if not self._active:
            return
        self._active = False
        if self._loop is not None:
            self._loop_ends = True
            self._loop.join()
            self._loop = None
        try:
            if not isinstance(self._failure, BackendFault):
                self._engine.return_to_rest()
            while not self._engine.idle:
                self._publish(self._engine.advance())
            for _ in range(self._engine.lead_ticks):
                self._publish(self._engine.advance())
        except BackendFault as fault:
            self._latch.stop(str(fault))
            self.get_logger().error(f"stopped: {fault}")
        finally:
            self._goals.finish(self._engine.stop_cause or cause, self._engine.last_sample)
            self._backend.close()

    # Time

    def step(self):
        """Advance a lockstep stage; return how long to wait for the next callback (s)."""
        if self._failure is not None:
            self._fail()
        if not self.settings.lockstep or not self._active or self._engine.idle:
            return IDLE_WAIT_S
        if self._engine.awaiting_answer:
            now = time.monotonic()
            if self._answer_deadline is None:
                self._answer_deadline = now + self.settings.lockstep_timeout_s
            if now < self._answer_deadline:
                return min(IDLE_WAIT_S, self._answer_deadline - now)
        self._answer_deadline = None
        try:
            self._advance()
        except BackendFault as fault:
            self._failure = fault
        return 0.0

    def _run_paced(self):
        try:
            while not self._loop_ends:
                while not self._commands.empty():
                    self._commands.get()()
                self._advance()
        except Exception as error:  # whatever it is: the main thread sees to it
            self._failure = error

    def _fail(self):
        """Leave the active state after a fault of the backend; any other error ends the node."""
        failure = self._failure
        if not isinstance(failure, BackendFault):
            raise failure
        self._latch.stop(str(failure))
        self.get_logger().error(f"stopped: {failure}")
        self.trigger_deactivate()
        self._failure = None
        self._publish_diagnostics()

    def _advance(self):
        engine = self._engine
        was_stopped = engine.stop_cause
        self._goals.attend(engine)
        self._publish(engine.advance())
        if engine.stop_cause and not was_stopped:
            self.get_logger().error(f"stopped: {engine.stop_cause}")
            self._publish_diagnostics()
        if engine.idle:
            if self.settings.lockstep:
                # Time stands still from here on: one block at rest tells that all is over.
                self._publish(engine.advance())
            self._goals.finish(engine.stop_cause, engine.last_sample)

    def on_block(self, block):
        """Take part when a block is published; for stages that know more than they measure."""

    def _publish(self, block):
        if block is None:
            return
        self._latency.published(block.tick)
        self._outputs.publish_block(block, self._engine.next_sample, self._engine.idle)
        self.on_block(block)

    def _command(self, function, *arguments):
        """Run a command between two ticks; return what it returns, raise what it raises.

        Parameters
        ----------
        function : callable
            Takes the engine and the arguments.

        Raises
        ------
        ValueError
            If the command is refused.
        """
        if not self._active:
            raise ValueError("the stage is not active: activate it first")
        if self._loop is None:
            return function(self._engine, *arguments)
        outcome = queue.SimpleQueue()

        def run():
            try:
                outcome.put((function(self._engine, *arguments), None))
            except ValueError as error:
                outcome.put((None, error))
        self._commands.put(run)
        try:
            value, error = outcome.get(timeout=COMMAND_TIMEOUT_S)
        except queue.Empty:
            raise ValueError("the stage left the active state: activate it again") from None
        if error is not None:
            raise error
        return value

    # Watching

    def _watch_client(self):
        client = self._engine.client if self._active else ""
        if self._client_watch.is_gone(client):
            self._stop(f"the client {client} is gone")

    def _stop(self, cause):
        """Stop from whatever state, until somebody resets it."""
        known = self._latch.cause
        try:
            self._command(lambda engine: engine.stop(cause))
        except ValueError:  # not active: nothing moves
            self._latch.stop(cause)
        if not known:
            self.get_logger().error(f"stopped: {cause}")
        self._publish_diagnostics()

    def _publish_diagnostics(self):
        engine = self._engine
        if self._latch.cause:
            level, message = DiagnosticStatus.ERROR, self._latch.cause
        elif engine is None or not self._active:
            level, message = DiagnosticStatus.OK, "not active"
        elif engine.missed_feedback:
            level, message = DiagnosticStatus.WARN, "feedback answers were missed"
        else:
            level, message = DiagnosticStatus.OK, engine.phase_name
        values = {} if engine is None else {
            "phase": engine.phase_name if self._active else "not active",
            "client": engine.client,
            "voltage_v": f"{engine.voltage_v:.4f}", "next_sample": engine.next_sample,
            "missed_feedback": engine.missed_feedback, **self._latency.described()}
        self._outputs.publish_diagnostics(level, message, values)

    # Tracking and stops

    def _on_feedback(self, message):
        if self._engine is None:
            return
        self._latency.answered(message.tick)
        try:
            self._engine.answer(message.tick, message.voltage_v)
        except ValueError as error:
            self.get_logger().warning(f"feedback refused: {error}")

    def _answer_service(self, response, name, *arguments):
        """Run an engine command for a service; return its value, or None where it is refused."""
        try:
            value = self._command(lambda engine: getattr(engine, name)(*arguments))
        except ValueError as error:
            response.success, response.message = False, f"{name} refused: {error}"
            self.get_logger().warning(response.message)
            return None
        response.success = True
        return value

    def _on_load_feedforward(self, request, response):
        self._answer_service(response, "load_feedforward", request.once_voltage_v,
                             request.period_voltage_v, request.append)
        return response

    def _on_start_tracking(self, request, response):
        first_tick = self._answer_service(
            response, "start_tracking", request.feedback, request.ticks, request.client)
        response.first_tick = first_tick or 0
        return response

    def _on_stop_tracking(self, request, response):
        self._answer_service(response, "stop_tracking")
        return response

    def _on_emergency_stop(self, request, response):
        self._stop("emergency stop")
        response.success = True
        return response

    def _on_reset(self, request, response):
        if self._active:
            self._answer_service(response, "reset")
        else:
            self._latch.reset()
            response.success = True
        return response


def main(args=None):
    """Run the node ``stage`` over the backend that its parameters name."""
    run_node(lambda: StageNode(_chosen_backend), args)


def _chosen_backend(node):
    name = declare(node, "backend", "nidaqmx", "Name of the backend, such as nidaqmx.")
    file = declare(node, "backend_file", "", "Settings of the backend, such as its calibration.")
    return create_backend(name, node.settings.for_backend(file))
