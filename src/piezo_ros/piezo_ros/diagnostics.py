# SPDX-License-Identifier: BSD-3-Clause
"""The state of a node, as published on ``/diagnostics`` (REP-107)."""

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node


def diagnostic(node: Node, name: str, level: bytes, message: str, values: Mapping[str, object],
               hardware_id: str = "") -> DiagnosticArray:
    """Return the present state of a part of a node, with a level from ``DiagnosticStatus``."""
    status = DiagnosticStatus(
        name=f"{node.get_fully_qualified_name()}: {name}", hardware_id=hardware_id, level=level,
        message=message,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])
    array = DiagnosticArray(status=[status])
    array.header.stamp = node.get_clock().now().to_msg()
    return array
