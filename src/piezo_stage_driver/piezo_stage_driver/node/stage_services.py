# SPDX-License-Identifier: BSD-3-Clause
"""The services of the stage node: tracking, stops and the reset."""

import threading
import time
from collections.abc import Callable
from typing import Any

from piezo_interfaces.srv import (
    LoadFeedback,
    LoadFeedforward,
    ReplaceFeedforward,
    StartTracking,
)
from rclpy.node import Node
from std_srvs.srv import Trigger

from piezo_ros.late_responses import LateResponse, create_late_service
from piezo_stage_driver.engine.stage_commands import StageCommands
from piezo_stage_driver.node.command_router import CommandRouter
from piezo_stage_driver.node.law_of_message import law_of
from piezo_stage_driver.safety.commands import Command
from piezo_stage_driver.safety.request_memory import RequestMemory
from piezo_stage_driver.safety.supervisor import UNSAFE
from piezo_stage_driver.safety.transitions import Event


class StageServices:
    """Serve the requests of clients without blocking the executor.

    A stop may take `emergency_stop_timeout_s` in addition to the ramp to rest.
    """

    def __init__(self, node: Node, router: CommandRouter,
                 emergency_stop_timeout_s: float) -> None:
        self._node, self._router = node, router
        self._stop_timeout_s = emergency_stop_timeout_s
        self._loads, self._laws, self._starts, self._replacements = (
            RequestMemory() for _ in range(4))
        # Each with its deadline, and the time from the request to it (s).
        self._stops: list[tuple[LateResponse, float, float]] = []
        self._lock = threading.Lock()
        for service_type, name, callback in (
                (LoadFeedforward, "load_feedforward", self._on_load_feedforward),
                (LoadFeedback, "load_feedback", self._on_load_feedback),
                (ReplaceFeedforward, "replace_feedforward", self._on_replace_feedforward),
                (StartTracking, "start_tracking", self._on_start_tracking),
                (Trigger, "reset", self._on_reset)):
            create_late_service(node, service_type, name, callback)
        # A late command that leads to rest is better than none.
        create_late_service(node, Trigger, "stop_tracking", self._on_stop_tracking, acts_late=True)
        create_late_service(
            node, Trigger, "emergency_stop", self._on_emergency_stop, acts_late=True)

    def settle(self) -> None:
        """Answer the emergency stops that have ended or taken too long; from any thread."""
        if not self._stops:
            return
        rest, possible = self._router.at_rest, self._router.can_come_to_rest
        now_s = time.monotonic()
        with self._lock:
            over = [stop for stop in self._stops
                    if rest or not possible or stop[1] <= now_s]
            self._stops = [stop for stop in self._stops if stop not in over]
        for late, _, wait_s in over:
            late.response.success = rest
            if rest:
                late.response.message = "the amplifier is at rest"
            elif not possible:
                late.response.message = f"the backend failed before rest was reached; {UNSAFE}"
            else:
                late.response.message = f"rest was not reached within {wait_s:.3g} s; {UNSAFE}"
            if not rest:
                self._node.get_logger().error(f"emergency stop: {late.response.message}")
            late.give()

    def _ask(self, late: LateResponse, service: str, event: Event,
             act: Callable[[StageCommands], Any], fill: Callable[[Any, Any], None] | None = None,
             run: int | None = None) -> None:
        """Submit a command; answer when it has acted or is refused."""
        def done(value: Any, error: ValueError | None) -> None:
            if error is not None:
                self._refuse(late, service, error)
                return
            late.response.success = True
            if fill:
                fill(late.response, value)
            late.give()

        self._router.submit(Command(event, act, on_done=done, run=run, asked_s=late.asked_s))

    def _refuse(self, late: LateResponse, name: str, error: ValueError) -> None:
        late.response.success = False
        late.response.message = f"{name} refused: {error}"
        self._node.get_logger().warning(late.response.message)
        late.give()

    def _on_load_feedback(self, request: LoadFeedback.Request, late: LateResponse) -> None:
        if self._laws.repeats(request.request_id, late):
            return
        try:
            # Checked here, as this takes longer than a tick may.
            law = self._router.checks.checked(law_of(request.law))
        except ValueError as error:
            self._refuse(late, "load_feedback", error)
        else:
            self._ask(late, "load_feedback", Event.LAW,
                      lambda stage: stage.load_feedback(law, request.feedforward_id))

    def _on_load_feedforward(self, request: LoadFeedforward.Request, late: LateResponse) -> None:
        def fill(response: LoadFeedforward.Response, feedforward_id: int) -> None:
            response.feedforward_id = feedforward_id

        if not self._loads.repeats(request.request_id, late):
            self._ask(late, "load_feedforward", Event.APPEND if request.append else Event.LOAD,
                      lambda stage: stage.load_feedforward(
                          request.once_voltage_v, request.period_voltage_v, request.append,
                          request.feedforward_id, request.axes, request.once_marks,
                          request.period_marks), fill)

    def _on_replace_feedforward(self, request: ReplaceFeedforward.Request,
                                late: LateResponse) -> None:
        def fill(response: ReplaceFeedforward.Response, first_tick: int) -> None:
            response.first_tick = first_tick

        if self._replacements.repeats(request.request_id, late):
            return
        try:
            replacement = self._router.checks.replacement(
                request.once_voltage_v, request.period_voltage_v,
                law_of(request.law) if request.onboard else None)
        except ValueError as error:
            self._refuse(late, "replace_feedforward", error)
        else:
            self._ask(late, "replace_feedforward", Event.REPLACE,
                      lambda stage: stage.replace_feedforward(replacement), fill, request.run)

    def _on_start_tracking(self, request: StartTracking.Request, late: LateResponse) -> None:
        def fill(response: StartTracking.Response, value: tuple[int, int]) -> None:
            response.run, response.first_tick = value

        if not self._starts.repeats(request.request_id, late):
            self._ask(late, "start_tracking", Event.TRACK, lambda stage: stage.start_tracking(
                request.feedback, request.ticks, request.client, request.onboard,
                request.feedforward_id), fill)

    def _on_stop_tracking(self, request: Trigger.Request, late: LateResponse) -> None:
        self._ask(late, "stop_tracking", Event.END_TRACKING,
                  lambda stage: stage.stop_tracking(late.asked_s))

    def _on_reset(self, request: Trigger.Request, late: LateResponse) -> None:
        self._ask(late, "reset", Event.RESET, lambda stage: stage.reset(late.asked_s))

    def _on_emergency_stop(self, request: Trigger.Request, late: LateResponse) -> None:
        wait_s = self._stop_timeout_s + self._router.seconds_to_rest
        self._router.stop("emergency stop")
        with self._lock:
            self._stops.append((late, time.monotonic() + wait_s, wait_s))
        self.settle()
