# SPDX-License-Identifier: BSD-3-Clause
"""Spin such that exceptions of callbacks reach the caller.

The events executor of this rclpy ends the process by a segmentation fault if a task raises: any
task of ``create_task``, and every callback of actions and services.
"""

import threading

import rclpy.task
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor


class _Raised(threading.local):
    """Exceptions of tasks of the present thread since the last check."""

    def __init__(self) -> None:
        self.errors: list[Exception] = []


_raised = _Raised()


class _Task(rclpy.task.Task):
    """A task that passes its exception to `spin_once` instead of the executor."""

    def set_exception(self, exception: Exception) -> None:
        """Store the exception, and complete the task."""
        _raised.errors.append(exception)
        self.set_result(None)


def make_executor(context: Context | None = None) -> Executor:
    """Return an events executor, for use with `spin_once`; by default in the default context."""
    names = vars(rclpy.task)
    usual, names["Task"] = names["Task"], _Task  # the executor looks it up when it is created
    try:
        return EventsExecutor(context=context)
    finally:
        names["Task"] = usual


def spin_once(executor: Executor, timeout_s: float) -> None:
    """Run the callbacks that are ready, or wait for one; raise the first exception of a task.

    The executor is one of `make_executor`.
    """
    executor.spin_once(timeout_sec=timeout_s)
    if _raised.errors:
        errors, _raised.errors = _raised.errors, []
        raise errors[0]
