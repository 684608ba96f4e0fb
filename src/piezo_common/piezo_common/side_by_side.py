# SPDX-License-Identifier: BSD-3-Clause
"""Fits that do not depend on each other, side by side on the cores of the machine.

They run in threads: all share the recordings, which would be copied to processes, and the kernels
in which the time goes hold no lock of the interpreter.
"""

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

from piezo_common.cancellation import also_checking, check_cancelled

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_THREADS = 4
"""Each holds a few copies of the longest recording."""

_this_thread = threading.local()
"""Has `is_beside_others` in threads that do one item while others do the next."""


class OthersEnded(Exception):
    """An item is done for nothing, as the work beside others has ended."""


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (
        os.cpu_count() or 1)


def side_by_side(work: Callable[[Item], Result], items: Sequence[Item],
                 report: Callable[[int], None] | None = None,
                 threads: int | None = None) -> list[Result]:
    """Return the result of each item, in their order and the same on any number of cores.

    Parameters
    ----------
    work : callable
        Depends on its item alone.
    report : callable, optional
        Called with the number of each item, in their order, by the caller's thread. What it raises,
        or Ctrl-C, ends the work where the items that have begun call `check_cancelled` next.
    threads : int, optional
        By default one for each core, but no more than `MOST_THREADS`; within an item that is done
        beside others one alone, as the cores are busy.
    """
    if threads is None:
        is_beside = getattr(_this_thread, "is_beside_others", False)
        threads = 1 if is_beside else min(len(items), MOST_THREADS, cores())
    results = []
    if threads <= 1:
        for number, item in enumerate(items):
            if report is not None:
                report(number)
            check_cancelled()
            results.append(work(item))
        return results
    have_ended = threading.Event()

    def check() -> None:
        if have_ended.is_set():
            raise OthersEnded

    def done(item: Item) -> Result:
        with also_checking(check):
            check_cancelled()
            return work(item)

    with ThreadPoolExecutor(threads, initializer=_mark) as pool:
        # Each in a copy of the caller's context, so that what ends the caller's work ends them.
        futures = [pool.submit(copy_context().run, done, item) for item in items]
        try:
            for number, future in enumerate(futures):
                if report is not None:
                    report(number)
                results.append(future.result())
        except BaseException:
            have_ended.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return results


def _mark() -> None:
    """Mark the thread as one of several, so that its own work takes no more of them."""
    _this_thread.is_beside_others = True
