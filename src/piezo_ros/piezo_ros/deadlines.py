# SPDX-License-Identifier: BSD-3-Clause
"""Requests say until when they may act, or when they were sent: one given up must not act."""

import time

from builtin_interfaces.msg import Time

from piezo_ros.messages import Message

NANOSECONDS = 1_000_000_000
NEVER = Time()
LONGEST_DELAY_S = 10.0
"""Between the sending of a request that cannot bear a deadline and the moment in which it acts."""


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


def why_too_late(request: Message, age_s: float = 0.0) -> str:
    """Say why a request must not act any more; empty where it may.

    Parameters
    ----------
    request : message
        A request or a goal; one whose deadline was left out may always act.
    age_s : float
        Time since it was sent (s), which decides where it cannot bear a deadline.
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
    """Return how long ago a request was sent (s); 0 where that is not known.

    Parameters
    ----------
    sent_ns : int
        Source timestamp of the middleware, by the wall clock of the client.
    """
    return max(time.time_ns() - sent_ns, 0) / NANOSECONDS if sent_ns > 0 else 0.0


def asks_the_same(one: Message, other: Message | None) -> bool:
    """Tell whether two requests of one type, or none, ask for the same, however long each waits."""
    return other is not None and all(
        getattr(one, name) == getattr(other, name)
        for name in one.get_fields_and_field_types() if name != "deadline")
