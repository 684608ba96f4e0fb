# SPDX-License-Identifier: BSD-3-Clause
"""Declare parameters with a description and a range."""

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor


def declare(node, name, default, description, minimum=None, maximum=None, read_only=True):
    """Declare a parameter and return its value.

    Parameters
    ----------
    node : rclpy.node.Node
    name : str
        Ends in the unit where the value has one.
    default : bool, int, float, str or list
        Gives the type as well.
    description : str
        One sentence for ``ros2 param describe``.
    minimum, maximum : float, optional
        Bounds, both included; give both or none.
    read_only : bool
        Refuse changes while the node runs.

    Raises
    ------
    rclpy.exceptions.InvalidParameterValueException
        If an override lies outside the range.
    """
    descriptor = ParameterDescriptor(name=name, description=description, read_only=read_only)
    if minimum is not None and isinstance(default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(minimum), to_value=float(maximum))]
    elif minimum is not None:
        descriptor.integer_range = [
            IntegerRange(from_value=int(minimum), to_value=int(maximum), step=1)]
    return node.declare_parameter(name, default, descriptor).value
