# SPDX-License-Identifier: BSD-3-Clause
"""Find out why a goal was rejected, as the rejection itself contains no reason."""

from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from piezo_ros.requests.goals import GOAL, GoalState

DIAGNOSTICS_S = 5.0
"""Time in s to wait for diagnostics, which nodes publish every second."""


def why_rejected(node: Node, spin_until: Callable[[Callable[[], bool], float], bool],
                 topic: str) -> str:
    """Return what the server of an action reports about its present goal.

    ``spin_until(condition, timeout_s)`` spins the node. The name of the action is relative to the
    namespace of both.
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
    return "it is busy with another goal or not active, its log states which"
