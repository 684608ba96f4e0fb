# SPDX-License-Identifier: BSD-3-Clause
"""Requests and goals say until when they may act: one that was given up must not act later."""

import time

from builtin_interfaces.msg import Time

from piezo_ros.messages import Message

NANOSECONDS = 1_000_000_000
NEVER = Time()


def set_deadline(request: Message, patience_s: float) -> None:
    """Let a request be refused once its client has given it up, if it can bear a deadline.

    Parameters
    ----------
    request : message
        A request or a goal. A deadline that it has stays.
    patience_s : float
        How long its client waits from now on, however often it asks (s).
    """
    if getattr(request, "deadline", None) == NEVER:
        nanoseconds = time.time_ns() + round(patience_s * NANOSECONDS)
        request.deadline = Time(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)


def why_too_late(request: Message) -> str:
    """Say why a request must not act any more; empty where it may.

    Parameters
    ----------
    request : message
        A request or a goal; one without a deadline may always act.
    """
    deadline = getattr(request, "deadline", NEVER)
    if deadline == NEVER:
        return ""
    late_s = time.time() - deadline.sec - deadline.nanosec / NANOSECONDS
    if late_s <= 0.0:
        return ""
    return (f"its client gave this request up {late_s:.3g} s ago: ask again; between two machines, "
            "compare their clocks")


def asks_the_same(one: Message, other: Message | None) -> bool:
    """Tell whether two requests of one type, or none, ask for the same, however long each waits."""
    return other is not None and all(
        getattr(one, name) == getattr(other, name)
        for name in one.get_fields_and_field_types() if name != "deadline")
