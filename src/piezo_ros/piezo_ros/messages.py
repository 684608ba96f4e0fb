# SPDX-License-Identifier: BSD-3-Clause
"""Types of what ROS generates, which bears no annotations of its own."""

from typing import Any, TypeAlias

Message: TypeAlias = Any
"""A message, or a request, a response, a goal or a result."""

MessageType: TypeAlias = type[Any]
"""The class of a message, of a service or of an action."""
