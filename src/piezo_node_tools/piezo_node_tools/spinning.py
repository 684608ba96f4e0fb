# SPDX-License-Identifier: BSD-3-Clause
"""Start a node, spin it, and close it in order, whatever ends it."""

import signal
import time

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions

SPIN_TIMEOUT_S = 0.2
WIND_DOWN_TIMEOUT_S = 10.0


def run_node(create_node, args=None):
    """Run one node until SIGINT or SIGTERM.

    The node may have methods of its own: ``step() -> float`` is called between two
    callbacks and returns how long to wait for the next one (s); ``wind_down() -> bool``
    is called once the end is near, between callbacks, until it returns True; ``close()``
    is called last, while ROS still works.

    Parameters
    ----------
    create_node : callable
        Makes the node; called without arguments once ROS is initialised.
    args : list of str, optional
        Command line; ``sys.argv`` where it is left out.
    """
    # Own handlers: rclpy's would shut ROS down before the node can close in order.
    stop_requested = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop_requested.append(True))
    rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    node = create_node()
    executor = EventsExecutor()
    executor.add_node(node)
    try:
        _spin(executor, getattr(node, "step", lambda: SPIN_TIMEOUT_S), stop_requested)
        _wind_down(executor, getattr(node, "wind_down", lambda: True))
    finally:
        getattr(node, "close", lambda: None)()
        executor.remove_node(node)
        node.destroy_node()
        rclpy.try_shutdown()


def _spin(executor, step, stop_requested):
    while not stop_requested and rclpy.ok():
        executor.spin_once(timeout_sec=step())


def _wind_down(executor, wind_down):
    deadline = time.monotonic() + WIND_DOWN_TIMEOUT_S
    while not wind_down() and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.05)
