# SPDX-License-Identifier: BSD-3-Clause
"""The stage as a lifecycle node: one interface over every backend."""

import array
import functools
import queue
import threading
import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from piezo_interfaces.action import PlayWaveform
from piezo_interfaces.msg import FeedbackVoltage, SampleBlock
from piezo_interfaces.srv import LoadFeedforward, StartTracking
from rclpy.action import ActionServer, CancelResponse
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from piezo_node_tools.parameters import declare
from piezo_node_tools.quality import FEEDBACK, PACED_SAMPLES, SAMPLES
from piezo_node_tools.spinning import autostart
from piezo_stage_driver.engine import StageEngine
from piezo_stage_driver.limits import VoltageLimits

NANOSECONDS = 1_000_000_000
IDLE_WAIT_S = 0.05
COMMAND_TIMEOUT_S = 5.0
# The middleware asks for acknowledgements every 3 s.
DELIVERY_TIMEOUT_S = 5.0
# ROS itself gives a dead subscriber up after 20 s.
LONGEST_HOLD_BACK_S = 30.0


class StageNode(LifecycleNode):
    """Publish what the stage measures, play what it is sent, within its limits.

    With ``timing`` *paced* the backend's clock drives the stage in a thread of its own.
    With *lockstep* stage time passes only while something plays, and each tick that
    needs an answer waits for it; results then do not depend on the machine's speed.

    Parameters
    ----------
    create_backend : callable
        Takes the node, returns a ``StageBackend``; called when the node is configured.
    """

    def __init__(self, create_backend):
        super().__init__("stage")
        self._create_backend = create_backend
        self._declare_parameters()
        self._backend = self._engine = self._loop = None
        self._commands = queue.SimpleQueue()
        self._active = False
        self._failure = None
        self._losing_samples = False
        self._goal = self._goal_result = None
        self._goals_unanswered = 0
        self._samples_since_joint_state = self._samples_since_clock = 0
        self._answer_deadline = None
        self._epoch_ns = 0

        self._samples_quality = SAMPLES if self._lockstep else PACED_SAMPLES
        self._samples = self.create_publisher(SampleBlock, "samples", self._samples_quality)
        self._joint_states = self.create_publisher(JointState, "joint_states", 10)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._clock_publisher = (
            self.create_publisher(ClockMessage, "/clock", 10) if self._lockstep else None)
        self.create_subscription(FeedbackVoltage, "feedback", self._on_feedback, FEEDBACK)
        self.create_service(LoadFeedforward, "load_feedforward", self._on_load_feedforward)
        self.create_service(StartTracking, "start_tracking", self._on_start_tracking)
        self.create_service(Trigger, "stop_tracking", self._on_stop_tracking)
        self.create_service(Trigger, "emergency_stop", self._on_emergency_stop)
        self.create_service(Trigger, "reset", self._on_reset)
        self._play_server = ActionServer(
            self, PlayWaveform, "play_waveform", self._end_goal,
            handle_accepted_callback=self._on_play,
            cancel_callback=lambda goal: CancelResponse.ACCEPT)
        self.create_timer(1.0, self._publish_diagnostics,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))
        autostart(self, default=False)

    def _declare_parameters(self):
        self._sample_rate_hz = declare(
            self, "sample_rate_hz", 40000.0, "Rate of the sample clock (Hz).", 1000.0, 200000.0)
        self._samples_per_tick = declare(
            self, "samples_per_tick", 40, "Samples of one feedback period.", 1, 4000)
        self._minimum_voltage_v = declare(
            self, "minimum_voltage_v", -20.0, "Lowest voltage allowed (V).", -1000.0, 1000.0)
        self._maximum_voltage_v = declare(
            self, "maximum_voltage_v", 120.0, "Highest voltage allowed (V).", -1000.0, 1000.0)
        self._rest_voltage_v = declare(
            self, "rest_voltage_v", 0.0, "Voltage while nothing plays (V).", -1000.0, 1000.0)
        self._slew_limit_v_per_s = declare(
            self, "slew_limit_v_per_s", 2.0e6,
            "Largest voltage step of one sample over the sample period (V/s).", 1.0, 1.0e9)
        self._ramp_rate_v_per_s = declare(
            self, "ramp_rate_v_per_s", 2000.0,
            "Rate of the ramps to the first sample and to rest (V/s).", 1.0, 1.0e6)
        self._max_missed_feedback = declare(
            self, "max_missed_feedback", 5,
            "More feedback answers missed in a row stop the stage.", 0, 10000)
        self._lockstep = declare(
            self, "timing", "paced",
            "paced (the clock of the backend) or lockstep (as fast as the loop answers).",
            choices=("paced", "lockstep")) == "lockstep"
        self._lockstep_timeout_s = declare(
            self, "lockstep_timeout_s", 2.0,
            "Wall time after which an answer counts as missed in lockstep (s).", 0.01, 600.0)
        self._joint_name = declare(
            self, "joint_name", "stage", "Name of the joint in joint_states.")
        self._joint_state_rate_hz = declare(
            self, "joint_state_rate_hz", 50.0, "Rate of joint_states (Hz).", 0.1, 1000.0)

    # Lifecycle

    def on_configure(self, state):
        """Make the backend and check the limits."""
        try:
            self._limits = VoltageLimits(
                self._minimum_voltage_v, self._maximum_voltage_v, self._slew_limit_v_per_s)
            self._backend = self._create_backend(self)
            self._engine = self._create_engine()
        except ValueError as error:
            self.get_logger().error(f"cannot configure: {error}")
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state):
        """Start the sample clock at sample 0."""
        try:
            self._backend.open()
        except (ValueError, OSError) as error:
            self.get_logger().error(f"cannot activate: {error}")
            return TransitionCallbackReturn.FAILURE
        self._engine = self._create_engine()
        self._epoch_ns = 0 if self._lockstep else self.get_clock().now().nanoseconds
        self._active = True
        if not self._lockstep:
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
        return not self._goals_unanswered

    def close(self):
        """Let subscribers have the last samples before the process ends."""
        self._samples.wait_for_all_acked(Duration(seconds=DELIVERY_TIMEOUT_S))

    def _create_engine(self):
        return StageEngine(
            self._backend, self._limits, self._rest_voltage_v, self._ramp_rate_v_per_s,
            self._samples_per_tick, self._max_missed_feedback,
            **({} if self._lockstep else {"longest_chunk_samples": self._samples_per_tick}))

    def _leave_active(self, cause):
        if not self._active:
            return
        self._active = False
        if self._loop is not None:
            self._loop_ends = True
            self._loop.join()
            self._loop = None
        try:
            if self._engine.voltage_v != self._rest_voltage_v or not self._engine.idle:
                self._engine.return_to_rest()
            while not self._engine.idle:
                self._publish(self._engine.advance())
        finally:
            self._finish_goal(cause)
            self._backend.close()

    # Time

    def step(self):
        """Advance a lockstep stage; return how long to wait for the next callback (s)."""
        if self._failure is not None:
            raise self._failure
        if not self._lockstep or not self._active or self._engine.idle:
            return IDLE_WAIT_S
        if self._engine.awaiting_answer:
            now = time.monotonic()
            if self._answer_deadline is None:
                self._answer_deadline = now + self._lockstep_timeout_s
            if now < self._answer_deadline:
                return min(IDLE_WAIT_S, self._answer_deadline - now)
        self._answer_deadline = None
        self._advance()
        return 0.0

    def _run_paced(self):
        try:
            while not self._loop_ends:
                while not self._commands.empty():
                    self._commands.get()()
                self._advance()
        except Exception as error:  # whatever it is: the main thread returns to rest and ends
            self._failure = error

    def _advance(self):
        was_stopped = self._engine.stop_cause
        self._attend_goal()
        self._publish(self._engine.advance())
        if self._engine.stop_cause and not was_stopped:
            self.get_logger().error(f"stopped: {self._engine.stop_cause}")
        if self._engine.idle:
            if self._lockstep:
                # Time stands still from here on: one block at rest tells that all is over.
                self._publish(self._engine.advance())
            self._finish_goal(self._engine.stop_cause)

    def on_block(self, block):
        """Take part when a block is published; for stages that know more than they measure."""

    def _command(self, function, *arguments):
        """Run a command between two ticks; return what it returns, raise what it raises."""
        if not self._active:
            raise ValueError("the stage is not active: activate it first")
        if self._loop is None:
            return function(*arguments)
        outcome = queue.SimpleQueue()

        def run():
            try:
                outcome.put((function(*arguments), None))
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

    # Publishing

    def _stamp(self, sample):
        nanoseconds = self._epoch_ns + round(sample / self._sample_rate_hz * NANOSECONDS)
        return Time(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)

    def _publish(self, block):
        if block is None:
            return
        message = SampleBlock(
            first_sample=block.first_sample, sample_period_s=block.sample_period_s,
            tick=block.tick, flags=block.flags, missed_feedback=block.missed_feedback,
            voltage_v=array.array("d", block.voltage_v.tobytes()),
            displacement_um=array.array("d", block.displacement_um.tobytes()))
        message.header.stamp = self._stamp(block.first_sample)
        message.header.frame_id = self._joint_name
        self.publish_samples(self._samples, message)
        self.on_block(block)
        samples = self._engine.next_sample - block.first_sample
        self._publish_joint_state(block, samples)
        if self._lockstep:
            self._publish_clock(samples)

    def publish_samples(self, publisher, message):
        """Publish; in lockstep wait for a subscriber that holds back, but not for ever."""
        patience_s = LONGEST_HOLD_BACK_S if self._lockstep and not self._losing_samples else 0.0
        deadline = time.monotonic() + patience_s
        while True:
            try:
                publisher.publish(message)
                self._losing_samples = False
                return
            except RuntimeError:  # of ROS: a subscriber made no room within 0.1 s
                if time.monotonic() < deadline:
                    continue
            if not self._losing_samples:
                self.get_logger().error(
                    f"samples are lost: a subscriber of {publisher.topic_name} hangs, end it")
            self._losing_samples = True
            return

    def _publish_joint_state(self, block, samples):
        self._samples_since_joint_state += samples
        if self._samples_since_joint_state * self._joint_state_rate_hz < self._sample_rate_hz:
            return
        self._samples_since_joint_state = 0
        message = JointState(name=[self._joint_name],
                             position=[float(block.displacement_um[-1]) * 1e-6])
        message.header.stamp = self._stamp(self._engine.next_sample)
        self._joint_states.publish(message)

    def _publish_clock(self, samples):
        self._samples_since_clock += samples
        if self._samples_since_clock < self._sample_rate_hz / 100 and not self._engine.idle:
            return
        self._samples_since_clock = 0
        self._clock_publisher.publish(ClockMessage(clock=self._stamp(self._engine.next_sample)))

    def _publish_diagnostics(self):
        engine = self._engine
        status = DiagnosticStatus(name=f"{self.get_fully_qualified_name()}: stage",
                                  hardware_id=self._joint_name)
        if engine is None or not self._active:
            status.level, status.message = DiagnosticStatus.OK, "not active"
        elif engine.stop_cause:
            status.level, status.message = DiagnosticStatus.ERROR, engine.stop_cause
        elif engine.missed_feedback:
            status.level = DiagnosticStatus.WARN
            status.message = "feedback answers were missed"
        else:
            status.level, status.message = DiagnosticStatus.OK, engine.phase_name
        if engine is not None:
            status.values = [
                KeyValue(key="voltage_v", value=f"{engine.voltage_v:.4f}"),
                KeyValue(key="next_sample", value=str(engine.next_sample)),
                KeyValue(key="missed_feedback", value=str(engine.missed_feedback))]
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    # Play a waveform

    def _on_play(self, goal_handle):
        try:
            self._command(self._begin_goal, goal_handle)
        except ValueError as error:
            message = f"waveform refused: {error}"
            self.get_logger().warning(message)
            self._answer_goal(goal_handle, PlayWaveform.Result(message=message))

    def _begin_goal(self, goal_handle):
        goal, result = goal_handle.request, PlayWaveform.Result()
        result.first_sample, result.samples = self._engine.play(
            goal.voltage_v, goal.sample_period_s, goal.repeats, goal.hold_at_end)
        self._goal, self._goal_result = goal_handle, result
        self._last_progress = time.monotonic()

    def _attend_goal(self):
        """Look whether the goal is to be cancelled, and tell how far it is."""
        goal = self._goal
        if goal is None:
            return
        if goal.is_cancel_requested and self._engine.phase_name != "return":
            self._engine.return_to_rest()
        now = time.monotonic()
        if now - self._last_progress < 0.1:
            return
        self._last_progress = now
        goal.publish_feedback(PlayWaveform.Feedback(
            stage=self._engine.phase_name, fraction=float(self._engine.fraction),
            seconds_left=float(self._engine.seconds_left)))

    def _finish_goal(self, message):
        if self._goal is not None:
            goal, result, self._goal, self._goal_result = self._goal, self._goal_result, None, None
            result.message, result.last_sample = message, self._engine.next_sample - 1
            result.success = not message
            self._answer_goal(goal, result)

    def _answer_goal(self, goal_handle, result):
        """Execute a goal now that it is over: the executor polls, busily, a goal that waits."""
        self._goals_unanswered += 1
        self.executor.create_task(
            goal_handle.execute, functools.partial(self._end_goal, result=result))

    def _end_goal(self, goal_handle, result):
        self._goals_unanswered -= 1
        if goal_handle.is_cancel_requested:
            result.success, result.message = False, "the waveform was cancelled"
            goal_handle.canceled()
        elif result.success:
            goal_handle.succeed()
        else:
            goal_handle.abort()
        return result

    # Tracking and stops

    def _on_feedback(self, message):
        if self._engine is None:
            return
        try:
            self._engine.answer(message.tick, message.voltage_v)
        except ValueError as error:
            self.get_logger().warning(f"feedback refused: {error}")

    def _answer_service(self, response, name, *arguments):
        """Run an engine command for a service; return its value, or None where it is refused."""
        try:
            value = self._command(lambda: getattr(self._engine, name)(*arguments))
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
            response, "start_tracking", request.feedback, request.ticks)
        response.first_tick = first_tick or 0
        return response

    def _on_stop_tracking(self, request, response):
        self._answer_service(response, "stop_tracking")
        return response

    def _on_emergency_stop(self, request, response):
        self._answer_service(response, "emergency_stop", "emergency stop")
        if response.success:
            self.get_logger().error("stopped: emergency stop")
        return response

    def _on_reset(self, request, response):
        self._answer_service(response, "reset")
        return response
