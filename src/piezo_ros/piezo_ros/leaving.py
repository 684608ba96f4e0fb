# SPDX-License-Identifier: BSD-3-Clause
"""End a node and its context, without an endless loop of Fast DDS from wheels.

As its participant is destroyed, Fast DDS 2.14 waits without a limit for the callbacks of discovery.
Compiled for wheels, the time of that wait overflows: it loops at full load, and keeps the lock that
the callback needs. About one client in a thousand ends while others are being discovered.
"""

import ctypes
import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node

CALLBACKS_END_S = 10
"""Limit of the wait for the callbacks of discovery, which take milliseconds."""

PARTICIPANT_OF_NODE = "_ZN16rmw_fastrtps_cpp22get_domain_participantEP10rmw_node_s"
SET_LISTENER = (
    "_ZN8eprosima7fastdds3dds17DomainParticipant12set_listenerEPNS1_25DomainParticipantListener"
    "ENSt6chrono8durationIlSt5ratioILl1ELl1EEEE")


def leave(node: Node) -> None:
    """Destroy a node, and shut down its context; both belong to nobody else.

    A node that has left already is left as it is.
    """
    with suppress(InvalidHandle):
        _end_discovery(node)
    node.destroy_node()
    node.context.try_shutdown()


def _end_discovery(node: Node) -> None:
    """Wait for the callbacks of discovery for a limited time, after which none of them begins."""
    functions = _fast_dds()
    if functions is None:
        return
    handle_of, participant_of, set_listener = functions
    with node.handle:
        participant = participant_of(handle_of(node.handle.pointer))
    if participant:
        set_listener(participant, None, CALLBACKS_END_S)


@cache
def _fast_dds() -> tuple[Callable[..., Any], ...] | None:
    """Return the functions that lead from a node to the listener, of the libraries in use.

    None if they are not there, as with another middleware or version.
    """
    try:
        rcl, rmw, fast_dds = (ctypes.CDLL(f"lib{name}", os.RTLD_LAZY | os.RTLD_NOLOAD) for name in (
            "rcl.so", "rmw_fastrtps_cpp.so", "fastrtps.so.2.14"))
        functions = (rcl.rcl_node_get_rmw_handle, rmw[PARTICIPANT_OF_NODE], fast_dds[SET_LISTENER])
    except (OSError, AttributeError):
        return None
    for function in functions:
        function.restype = ctypes.c_void_p
    functions[0].argtypes = functions[1].argtypes = [ctypes.c_void_p]
    functions[2].argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64]
    return functions
