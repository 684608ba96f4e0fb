# SPDX-License-Identifier: BSD-3-Clause
"""Detect from an action's status that a goal was accepted, or has ended, if the response was lost.

A server that has not discovered its new client yet cannot respond to it, but the status that it
publishes is kept for later subscribers.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from piezo_ros.messages import Message
from piezo_ros.quality import PROGRESS

ENDED = (GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_ABORTED)


class PatientActionClient(ActionClient):
    """An action client that works without the response to a goal, and asks again for a result."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._taken: set[bytes] = set()
        self._unanswered: list[tuple[UUID, Future]] = []
        self._ended: set[bytes] = set()
        self._results: list[tuple[ClientGoalHandle, Future]] = []
        super().__init__(*arguments, feedback_sub_qos_profile=PROGRESS, **options)

    def send_goal_async(self, goal: Message,
                        feedback_callback: Callable[[Message], object] | None = None,
                        goal_uuid: UUID | None = None) -> Future:
        """Send a goal; return a future for its handle."""
        number = goal_uuid or self._generate_random_uuid()
        answer = super().send_goal_async(goal, feedback_callback, number)
        self._unanswered = [(of, future) for of, future in self._unanswered if not future.done()]
        self._unanswered.append((number, answer))
        return answer

    async def execute(self, taken_data: dict[str, Any]) -> None:
        """Store the goals of a status, then do the same as every action client."""
        if status := taken_data.get("status"):
            self._taken |= {bytes(one.goal_info.goal_id.uuid) for one in status.status_list}
            self._ended |= {bytes(one.goal_info.goal_id.uuid) for one in status.status_list
                            if one.status in ENDED}
        await super().execute(taken_data)

    def settle(self) -> None:
        """Treat goals in a received status as accepted; call it when a response is late."""
        accepted = self._action_type.Impl.SendGoalService.Response(accepted=True)
        for number, answer in self._unanswered:
            if bytes(number.uuid) in self._taken and not answer.done():
                answer.set_result(ClientGoalHandle(self, number, accepted))

    def ask_again(self) -> None:
        """Ask again for the results of goals that have ended; call it when a result is late."""
        for of, result in self._late_results():
            if bytes(of.goal_id.uuid) in self._ended:
                super()._get_result_async(of).add_done_callback(partial(_pass_on, result))

    def _get_result_async(self, goal_handle: ClientGoalHandle) -> Future:
        result = super()._get_result_async(goal_handle)
        self._results = [*self._late_results(), (goal_handle, result)]
        return result

    def _late_results(self) -> list[tuple[ClientGoalHandle, Future]]:
        return [(of, result) for of, result in self._results if not result.done()]


def _pass_on(result: Future, again: Future) -> None:
    if not result.done():
        result.set_result(again.result())
