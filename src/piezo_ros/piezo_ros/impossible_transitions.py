# SPDX-License-Identifier: BSD-3-Clause
"""Respond to requests for transitions that a lifecycle node cannot make, or must not any more."""

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.service import Service

from piezo_ros.deadlines import seconds_since, why_too_late
from piezo_ros.messages import Message

RCLError = rclpy_implementation.RCLError


def answer_impossible_transitions(node: Node) -> None:
    """Make a node respond to an impossible ``change_state`` with false, and log the reason.

    rclpy raises an error in the executor instead, which ends the node without a response. A request
    that comes too late is rejected as well, as its client may have given it up. A node without a
    lifecycle is not changed.
    """
    for service in node.services:
        if service.srv_type is ChangeState:
            _answer_all(node, service)


def _answer_all(node: Node, service: Service) -> None:
    change_state, send_response = service.callback, service.send_response

    def answer(call: tuple[ChangeState.Request, ChangeState.Response], header: Message) -> None:
        request, response = call
        reason = why_too_late(request, seconds_since(header.source_timestamp))
        try:
            if not reason:
                response = change_state(request, response)
        except RCLError:
            reason = ("it does not lead on from the present state; "
                      "ask get_available_transitions which do")
        if reason:
            wanted = request.transition.label or request.transition.id
            node.get_logger().warning(f"transition {wanted} refused: {reason}")
            response.success = False
        send_response(response, header)

    # As in `create_late_service`.
    service.callback = lambda *call: call  # type: ignore[assignment, return-value]
    service.send_response = answer  # type: ignore[method-assign, assignment]
