# SPDX-License-Identifier: BSD-3-Clause
"""Protect the clock of a node against changes while something that uses it runs."""

from collections.abc import Callable

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

PARAMETER = "use_sim_time"


def keep_clock(node: Node, why_busy: Callable[[], str]) -> None:
    """Reject a change of the parameter ``use_sim_time`` while the node is busy.

    Time stamps before and after such a change belong to two clocks, which may differ by decades.
    The function returns what runs, for example ``"a goal runs"``; empty if nothing does.
    """
    def examine(parameters: list[Parameter]) -> SetParametersResult:
        changes = any(parameter.name == PARAMETER
                      and parameter.value != node.get_parameter(PARAMETER).value
                      for parameter in parameters)
        reason = changes and why_busy()
        if not reason:
            return SetParametersResult(successful=True)
        return SetParametersResult(successful=False, reason=(
            f"{PARAMETER} cannot be changed while {reason}: wait for its end, or end it first"))

    node.add_on_set_parameters_callback(examine)
