# SPDX-License-Identifier: BSD-3-Clause
"""Deadlines of requests, so that a request that its client has given up does not act."""

import time

from builtin_interfaces.msg import Time

from piezo_ros.messages import Message

NANOSECONDS = 1_000_000_000
NEVER = Time()
LONGEST_DELAY_S = 10.0
"""Longest delay in s from sending a request without a deadline to its effect."""


def set_deadline(request: Message, patience_s: float) -> None:
    """Set the deadline of a request or a goal, if it has such a field, to when its client gives up.

    The client waits for a time from now (s), for all its attempts. An existing deadline is not
    changed.
    """
    if getattr(request, "deadline", None) == NEVER:
        nanoseconds = time.time_ns() + round(patience_s * NANOSECONDS)
        request.deadline = Time(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)


def why_too_late(request: Message, age_s: float = 0.0) -> str:
    """Return why a request or a goal must not act any more; empty if it may.

    One with an empty deadline may always act. The age, in s, is used if it has no field for a
    deadline.
    """
    deadline = getattr(request, "deadline", None)
    if deadline is None:
        late_s = age_s - LONGEST_DELAY_S
        reason = f"it was sent {age_s:.3g} s ago, and its client may have given it up"
    elif deadline == NEVER:
        return ""
    else:
        late_s = time.time() - deadline.sec - deadline.nanosec / NANOSECONDS
        reason = f"its client gave this request up {late_s:.3g} s ago"
    if late_s <= 0.0:
        return ""
    return f"{reason}: ask again; between two machines, compare their clocks"


def seconds_since(sent_ns: int) -> float:
    """Return the time since a request was sent in s; 0 if it is not known.

    It was sent at the source time stamp of the middleware, by the wall clock of the client.
    """
    return max(time.time_ns() - sent_ns, 0) / NANOSECONDS if sent_ns > 0 else 0.0


def asks_the_same(one: Message, other: Message | None) -> bool:
    """Return True if two requests of one type differ at most in their deadlines; False for None."""
    return other is not None and all(
        getattr(one, name) == getattr(other, name)
        for name in one.get_fields_and_field_types() if name != "deadline")
