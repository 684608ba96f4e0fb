# SPDX-License-Identifier: BSD-3-Clause
"""Spin so that what a callback raises reaches who spins.

The events executor of this rclpy ends the process by a segmentation fault where a task raises: all
that is given to ``create_task``, and every callback of actions and services.
"""

import threading

import rclpy.task
from rclpy.context import Context
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor


class _Raised(threading.local):
    """What tasks of the present thread raised since it was looked at last."""

    def __init__(self) -> None:
        self.errors: list[Exception] = []


_raised = _Raised()


class _Task(rclpy.task.Task):
    """A task that hands what it raises to `spin_once`, in place of the executor."""

    def set_exception(self, exception: Exception) -> None:
        """Keep what was raised, and be done."""
        _raised.errors.append(exception)
        self.set_result(None)


def make_executor(context: Context | None = None) -> Executor:
    """Return an events executor, to be spun by `spin_once`.

    Parameters
    ----------
    context : rclpy.context.Context, optional
        The default one where it is left out.
    """
    names = vars(rclpy.task)
    usual, names["Task"] = names["Task"], _Task  # looked up by the executor as it is made
    try:
        return EventsExecutor(context=context)
    finally:
        names["Task"] = usual


def spin_once(executor: Executor, timeout_s: float) -> None:
    """Run the callbacks that are ready, or wait for one.

    Parameters
    ----------
    executor : rclpy.executors.Executor
        Of `make_executor`.

    Raises
    ------
    Exception
        The first that a task raised.
    """
    executor.spin_once(timeout_sec=timeout_s)
    if _raised.errors:
        errors, _raised.errors = _raised.errors, []
        raise errors[0]
