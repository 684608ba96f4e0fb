# SPDX-License-Identifier: BSD-3-Clause
"""Learn why a goal was rejected, which the rejection itself has no room for."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from piezo_ros.requests.goals import GOAL, GoalState

DIAGNOSTICS_S = 5.0
"""Every node that has something to tell does so each second."""


def why_rejected(node: Node, spin_until: Callable[[Callable[[], bool], float], bool],
                 topic: str) -> str:
    """Return what the node that serves an action says of its present goal.

    Parameters
    ----------
    node : rclpy.node.Node
        Of the client.
    spin_until : callable
        ``spin_until(condition, timeout_s)`` spins it.
    topic : str
        Of the action, relative to the namespace of both.
    """
    name = f"{node.get_namespace().rstrip('/')}/{topic.partition('/')[0]}: goal"
    heard: list[DiagnosticStatus] = []

    def hear(array: DiagnosticArray) -> None:
        heard.extend(status for status in array.status if status.name == name)

    subscription = node.create_subscription(DiagnosticArray, "/diagnostics", hear, 10)
    try:
        spin_until(lambda: bool(heard), DIAGNOSTICS_S)
    finally:
        node.destroy_subscription(subscription)
    if heard and KeyValue(key=GOAL, value=str(GoalState.NONE)) not in heard[-1].values:
        return f"it is {heard[-1].message}"
    return "it is busy with another goal or not active, its log tells which"
