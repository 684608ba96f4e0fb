# SPDX-License-Identifier: BSD-3-Clause
"""Declare parameters with a description and a range."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from piezo_common.data_root import DataRoot

Value = TypeVar(
    "Value", bound=bool | int | float | str | list[bool] | list[int] | list[float] | list[str])
"""Types of a parameter's value."""


class InvalidParameter(ValueError):
    """A node cannot start with the value of a parameter."""


def declare(node: Node, name: str, default: Value, description: str, minimum: float | None = None,
            maximum: float | None = None, read_only: bool = True,
            choices: Sequence[str] = ()) -> Value:
    """Declare a parameter, unless it is declared, and return its value.

    The name ends in the unit of the value, if there is one, and the default also determines the
    type. The description is the sentence for ``ros2 param describe``. The bounds are inclusive, and
    both or none are given; the choices are the allowed values of a string, or empty for any.
    Changes are rejected while the node runs if the parameter is read-only.

    Raise InvalidParameter if an override has another type, or is not an allowed value.
    """
    if node.has_parameter(name):
        return node.get_parameter(name).value
    descriptor = ParameterDescriptor(name=name, description=description, read_only=read_only)
    if minimum is not None and maximum is not None:
        if isinstance(default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(minimum), to_value=float(maximum))]
        else:
            descriptor.integer_range = [
                IntegerRange(from_value=int(minimum), to_value=int(maximum), step=1)]
    try:
        value = node.declare_parameter(name, default, descriptor).value
    except InvalidParameterTypeException:
        raise InvalidParameter(f"parameter {name} is no {type(default).__name__}: "
                               f"give a value such as {default!r}") from None
    except InvalidParameterValueException:
        raise InvalidParameter(f"parameter {name} is out of range: "
                               f"give a value from {minimum:.10g} to {maximum:.10g}") from None
    if choices and value not in choices:
        raise InvalidParameter(f"parameter {name} is {value!r}: give {' or '.join(choices)}")
    return value


def declare_data_root(node: Node) -> DataRoot:
    """Declare the parameter ``data_root`` and return the folder of the node's files.

    It is by default the folder in which the node was started. Raises `DataRootError` if it does not
    exist.
    """
    folder = declare(node, "data_root", str(Path.cwd()),
                     "Folder under which the node reads and writes the files that goals name.")
    return DataRoot(folder, node.get_name())
