# SPDX-License-Identifier: BSD-3-Clause
"""Start a node, spin it, and close it in order, whatever ends it."""

import faulthandler
import gc
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import rclpy
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from piezo_ros.discovery import LONGEST_STANDSTILL_S, holding_back, prepare_discovery
from piezo_ros.executor import make_executor, spin_once
from piezo_ros.heartbeat import Heartbeat
from piezo_ros.late_responses import answer_impossible_transitions
from piezo_ros.leaving import leave
from piezo_ros.memory_limit import end_before_stage, limit_memory
from piezo_ros.parameters import declare
from piezo_ros.process_watch import ProcessWatch
from piezo_ros.responses import answer_patiently

RCLError = rclpy_implementation.RCLError
SPIN_TIMEOUT_S = 0.2
WIND_DOWN_TIMEOUT_S = 10.0
LAST_WORDS_S = 0.2
# Nothing of an orderly end takes as long, also on a machine under heavy load.
LONGEST_END_S = 120.0
# A result is sent by a chain of callbacks, each of which schedules the next.
LAST_CALLBACKS = 5
FAILED_STATUS = 1
BAD_INPUT_STATUS = 2


class Ending:
    """Whether the node must end: on SIGINT or SIGTERM, or because other nodes no longer see it.

    Others give up a process that is suspended, for example by Ctrl-Z, and the middleware does not
    announce it to them again: when it continues, it hears them, but they do not hear it. It then
    stood still for `stood_still_s`, which is 0 in all other cases.
    """

    def __init__(self) -> None:
        self._requested = False
        self.stood_still_s = 0.0
        self._heartbeat = Heartbeat()
        # Own handlers, as rclpy's would shut ROS down before the node can close in order.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._end)

    def __bool__(self) -> bool:
        standstill_s = self._heartbeat.standstill_s()
        if standstill_s > LONGEST_STANDSTILL_S:
            self._requested, self.stood_still_s = True, standstill_s
        return self._requested

    def _end(self, *_: object) -> None:
        self._requested = True


def autostart(node: LifecycleNode, default: bool = True) -> None:
    """Configure and activate a lifecycle node if its parameter ``autostart`` is true.

    The process exits if a transition fails; the reason has then been logged.
    """
    if not declare(node, "autostart", default, "Configure and activate at start."):
        name = node.get_fully_qualified_name()
        node.get_logger().info(
            f"{name} is unconfigured and waits: ros2 lifecycle set {name} configure, then "
            "activate; or start it with --ros-args -p autostart:=true")
        return
    for trigger in (node.trigger_configure, node.trigger_activate):
        if trigger() != TransitionCallbackReturn.SUCCESS:
            sys.exit(BAD_INPUT_STATUS)


def run_node(create_node: Callable[[], Node], args: list[str] | None = None,
             expendable: bool = True, held_back: str = "") -> None:
    """Run one node until SIGINT or SIGTERM, or until it has been suspended for too long.

    If its end takes longer than 120 s, for example because the middleware blocks, the process
    prints where each of its threads stands, and ends with status 1.

    The node may define three methods. ``step() -> float`` is called between two callbacks and
    returns the time to wait for the next one in s. ``wind_down() -> bool`` is called between
    callbacks before the end, until it returns True. ``close()`` is called last, while ROS still
    works.

    `create_node` is called once ROS is initialised. A ValueError that it raises ends the process,
    which prints its text as one line. The arguments are ``sys.argv`` by default. The memory of an
    expendable node is limited by its parameter ``memory_limit_percent``, and the kernel ends it
    before other nodes. `held_back` is a topic of the node's namespace whose readers the node waits
    for; see ``holding_back``.

    Raise SystemExit with status 2 if the node cannot start with the given input, and with status 1
    if it was suspended for so long that the other nodes gave it up.
    """
    ending = Ending()
    node = _start(create_node, args, expendable, held_back)
    executor = make_executor()
    executor.add_node(node)
    watch = ProcessWatch(node)
    try:
        try:
            _spin(executor, getattr(node, "step", lambda: SPIN_TIMEOUT_S), ending)
        finally:
            # Unlike a thread of Python, it works also while another one holds the interpreter.
            faulthandler.dump_traceback_later(LONGEST_END_S, exit=True)
            if ending.stood_still_s:
                node.get_logger().error(
                    f"this process stood still for {ending.stood_still_s:.1f} s, and the other "
                    "nodes have given it up: it ends, start it again")
            _wind_down(executor, getattr(node, "wind_down", lambda: True))
    finally:
        getattr(node, "close", lambda: None)()
        watch.end()
        executor.remove_node(node)
        leave(node)
    if ending.stood_still_s:
        sys.exit(FAILED_STATUS)


def _start(create_node: Callable[[], Node], args: list[str] | None, expendable: bool,
           held_back: str) -> Node:
    prepare_discovery()
    answer_patiently()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        _refuse(str(error).split(", at /")[0])
    reason = ""
    try:
        with holding_back(held_back, sys.argv if args is None else args):
            node = create_node()
        if expendable:
            _limit_memory(node)
    except ValueError as error:
        reason = str(error)
    except RCLError as error:  # for example security that the middleware does not support
        reason = " ".join(str(error).split(", at /")[0].split())
    except SystemExit:  # of `autostart`; the reason has been logged
        pass
    else:
        answer_impossible_transitions(node)
        return node
    _leave_ros()
    _refuse(reason)


def _limit_memory(node: Node) -> None:
    end_before_stage()
    limit_memory(declare(
        node, "memory_limit_percent", 50.0,
        "Share of the machine's memory that this node may take (percent).", 1.0, 100.0))


def _leave_ros() -> None:
    """Destroy a partly created node before Python destroys what its threads depend on."""
    gc.collect()  # the node is unreachable, but its parts refer to each other
    rclpy.try_shutdown()


def _refuse(reason: str) -> NoReturn:
    if reason:
        print(f"{Path(sys.argv[0]).name}: {reason}", file=sys.stderr)
    sys.exit(BAD_INPUT_STATUS)


def _spin(executor: Executor, step: Callable[[], float], ending: Ending) -> None:
    while not ending and rclpy.ok():
        spin_once(executor, step())


def _wind_down(executor: Executor, wind_down: Callable[[], bool]) -> None:
    _spin_until(executor, wind_down, WIND_DOWN_TIMEOUT_S)
    for _ in range(LAST_CALLBACKS):
        behind_all_that_waits = executor.create_task(lambda: None)
        _spin_until(executor, behind_all_that_waits.done, WIND_DOWN_TIMEOUT_S)
    # Receivers of the last messages need time before the process is gone.
    _spin_until(executor, lambda: False, LAST_WORDS_S)


def _spin_until(executor: Executor, condition: Callable[[], bool], timeout_s: float) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < deadline:
        spin_once(executor, 0.05)
