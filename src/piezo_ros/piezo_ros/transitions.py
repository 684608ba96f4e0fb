# SPDX-License-Identifier: BSD-3-Clause
"""Answer requests for transitions that a lifecycle node cannot make in its present state."""

from collections.abc import Callable

from lifecycle_msgs.srv import ChangeState
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

RCLError = rclpy_implementation.RCLError
ChangeStateCallback = Callable[[ChangeState.Request, ChangeState.Response], ChangeState.Response]


def answer_impossible_transitions(node: Node) -> None:
    """Make a node answer an impossible ``change_state`` with false, and log why.

    rclpy raises an error in the executor instead, which ends the node without an answer.

    Parameters
    ----------
    node : rclpy.node.Node
        One without a lifecycle is left as it is.
    """
    for service in node.services:
        if service.srv_type is ChangeState:
            service.callback = _answering(node, service.callback)


def _answering(node: Node, change_state: ChangeStateCallback) -> ChangeStateCallback:
    def answer(
            request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        try:
            return change_state(request, response)
        except RCLError:
            wanted = request.transition.label or request.transition.id
            node.get_logger().warning(
                f"transition {wanted} refused: it does not lead on from the present state; "
                "ask get_available_transitions which do")
            response.success = False
            return response

    return answer
