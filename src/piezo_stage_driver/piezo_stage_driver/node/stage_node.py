# SPDX-License-Identifier: BSD-3-Clause
"""The stage as a lifecycle node: one interface for all backends."""

import sys
from collections.abc import Callable
from typing import Any, cast

from piezo_interfaces.msg import FeedbackVoltage
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.lifecycle.node import LifecycleState

from piezo_models.feedback_law.running_law import compile_law
from piezo_ros.clock_guard import keep_clock
from piezo_ros.discovery import deliver_in_background
from piezo_ros.parameters import declare
from piezo_ros.presence import ClientWatch
from piezo_ros.quality import FEEDBACK
from piezo_ros.spinning import autostart, run_node
from piezo_ros.starting import arguments_set
from piezo_stage_driver.backends.backend import BackendFault, StageBackend
from piezo_stage_driver.backends.registry import check_backend, create_backend
from piezo_stage_driver.engine.answer_latency import AnswerLatency
from piezo_stage_driver.engine.blocks import Block
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.engine.tick_times import TickTimes
from piezo_stage_driver.node.command_router import CommandRouter
from piezo_stage_driver.node.stage_loop import IDLE_WAIT_S, StageLoop
from piezo_stage_driver.node.stage_outputs import StageOutputs
from piezo_stage_driver.node.stage_reports import StageReports
from piezo_stage_driver.node.stage_services import StageServices
from piezo_stage_driver.node.stage_settings import StageSettings
from piezo_stage_driver.node.waveform_goals import WaveformGoals
from piezo_stage_driver.safety.guards import StopLatch
from piezo_stage_driver.safety.sample_kernels import compile_kernels
from piezo_stage_driver.safety.transitions import State

WATCH_PERIOD_S = 0.1
CLIENT_WATCH_PERIOD_S = 0.2
DIAGNOSTICS_PERIOD_S = 1.0
FEEDBACK_WARNING_PERIOD_S = 1.0


class StageNode(LifecycleNode):
    """Publish the measurements of the stage and play the received voltages, within its limits.

    With ``timing`` *paced* the backend's clock drives the stage in a thread of its own.
    With *lockstep* stage time passes only while something plays, and each tick that
    needs an answer waits for it; results then do not depend on the machine's speed.
    When the node is configured, `create_backend` is called with the node.
    """

    def __init__(self, create_backend: Callable[[Any], StageBackend]) -> None:
        super().__init__("stage")
        self._create_backend = create_backend
        self.settings = StageSettings(self)
        self._outputs = StageOutputs(self, self.settings)
        self._backend: StageBackend | None = None
        self._loop: StageLoop | None = None
        latch = self._latch = StopLatch()
        self._reports = StageReports(self, self._outputs, latch, lambda: self._loop)
        self._router = CommandRouter(self.settings.lockstep, latch, self._reports.report_stop)
        self._client_watch = ClientWatch(self)
        self._goals = WaveformGoals(self, self._router.submit)
        self._client_services = StageServices(
            self, self._router, self.settings.emergency_stop_timeout_s)
        feedback = self.create_subscription(
            FeedbackVoltage, "feedback", self._on_feedback, FEEDBACK)
        self._feedback_topic = feedback.topic_name
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(WATCH_PERIOD_S, self._watch, clock=clock)
        self.create_timer(CLIENT_WATCH_PERIOD_S, self._watch_client, clock=clock)
        self.create_timer(DIAGNOSTICS_PERIOD_S, self._reports.publish, clock=clock)
        keep_clock(self, lambda: "the stage is active" if self._active else "")
        autostart(self, default=False)

    # Lifecycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Create the backend, check the limits, and publish the description."""
        try:
            backend = self._create_backend(self)
            if not self.settings.lockstep:
                self._reports.tick_times = TickTimes(backend)
                backend = cast(StageBackend, self._reports.tick_times)
            supervisor = self.settings.create_supervisor(backend, self._latch)
            compile_law()
            compile_kernels()
        except ValueError as error:
            self.get_logger().error(f"cannot configure: {error}")
            return TransitionCallbackReturn.FAILURE
        self._backend, self._router.supervisor = backend, supervisor
        self._loop = StageLoop(supervisor, backend, self.settings, self._publish,
                               self._reports.report_stop, self._client_services.settle)
        self._outputs.describe(self.settings.description(backend))
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the sample clock at sample 0."""
        assert self._loop is not None  # an inactive node is configured
        try:
            self._loop.supervisor.activate()
        except (ValueError, OSError, BackendFault) as error:
            self.get_logger().error(f"cannot activate: {error}")
            return TransitionCallbackReturn.FAILURE
        self._outputs.epoch_ns = (
            0 if self.settings.lockstep else self.get_clock().now().nanoseconds)
        self._reports.latency = AnswerLatency()
        self._loop.begin()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Return to rest and stop the sample clock."""
        self._leave_active("the stage was deactivated")
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release the backend."""
        self._outputs.withdraw_description()
        self._backend = self._loop = self._router.supervisor = None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Return to rest from any state."""
        self._leave_active("the stage was shut down")
        self._outputs.withdraw_description()
        return TransitionCallbackReturn.SUCCESS

    def wind_down(self) -> bool:
        """Return to rest; return whether the client of the played program has its answer."""
        self._leave_active("the stage node was ended")
        return self._goals.answered

    def close(self) -> None:
        """Wait until subscribers have received the last samples, before the process ends."""
        self._outputs.wait_for_delivery()

    def _leave_active(self, cause: str) -> None:
        if self._loop is not None:
            self._loop.leave(cause)

    # Time

    def step(self) -> float:
        """Advance a lockstep stage; return how long to wait for the next callback (s)."""
        if self._loop is None:
            return IDLE_WAIT_S
        wait_s = self._loop.step()
        if self._loop.supervisor.state is State.FAULTED:
            self._reports.report_stop()
            self.trigger_deactivate()
            self._reports.publish()
        return wait_s

    def on_block(self, block: Block) -> None:
        """Called for each published block; for stages that know more than they measure."""

    def _publish(self, block: Block) -> None:
        engine = self._engine
        self._reports.latency.published(block.tick)
        self._outputs.publish_block(block, engine.next_sample, engine.idle)
        self.on_block(block)

    @property
    def _engine(self) -> StageEngine:
        """Engine of the configured stage."""
        assert self._loop is not None
        return self._loop.engine

    @property
    def _active(self) -> bool:
        return self._loop is not None and self._loop.active

    # Watching

    def _watch(self) -> None:
        if self._loop is None:
            return
        self._loop.watch()
        self._reports.report_stop()
        self._client_services.settle()

    def _watch_client(self) -> None:
        client = self._engine.client if self._active else ""
        if self._client_watch.is_gone(client):
            self._router.stop(f"the client {client} is gone")

    def _on_feedback(self, message: FeedbackVoltage) -> None:
        if self._loop is None or not self._loop.active:
            return
        self._reports.latency.answered(message.tick)
        try:
            self._loop.supervisor.answer(
                message.tick, message.voltage_v, message.run, self._one_node_answers)
        except ValueError as error:
            self.get_logger().warning(f"feedback refused: {error}",
                                      throttle_duration_sec=FEEDBACK_WARNING_PERIOD_S)
            self._reports.report_stop()

    def _one_node_answers(self) -> bool:
        return self.count_publishers(self._feedback_topic) <= 1


def run_stage(create_node: Callable[[], StageNode], args: list[str] | None = None) -> None:
    """Run a stage node; see ``run_node``.

    The ticks of a paced stage do not wait for subscribers. In lockstep they do, after few blocks,
    and a delivering thread would cost time in every tick. The kernel ends this node last of all
    when memory runs out.
    """
    lockstep = arguments_set("timing", "lockstep", sys.argv if args is None else args)
    if not lockstep:
        deliver_in_background()
    run_node(create_node, args, expendable=False, held_back="samples" if lockstep else "")


def main(args: list[str] | None = None) -> None:
    """Run the node ``stage`` with the backend that its parameters name."""
    run_stage(_create, args)


def _create() -> StageNode:
    node = StageNode(_chosen_backend)
    # An unknown name is refused now rather than when the stage is configured.
    check_backend(_backend_name(node))
    return node


def _backend_name(node: StageNode) -> str:
    return declare(node, "backend", "nidaqmx", "Name of the backend, such as nidaqmx.")


def _chosen_backend(node: StageNode) -> StageBackend:
    name = _backend_name(node)
    file = declare(node, "backend_file", "", "Settings of the backend, such as its calibration.")
    return create_backend(name, node.settings.for_backend(file))
