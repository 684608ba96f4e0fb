# SPDX-License-Identifier: BSD-3-Clause
"""Run independent fits in parallel on the cores of the machine.

They run in threads, which share the recordings without copies. Most of the time is spent in kernels
that release the interpreter lock.
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
"""Maximum number of threads; each holds a few copies of the longest recording."""

_this_thread = threading.local()
"""Has `is_beside_others` in threads that process one of several items."""


class OthersEnded(Exception):
    """An item is no longer needed, as the parallel work has ended."""


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (
        os.cpu_count() or 1)


def side_by_side(work: Callable[[Item], Result], items: Sequence[Item],
                 report: Callable[[int], None] | None = None,
                 threads: int | None = None) -> list[Result]:
    """Return the results of all items in their order, independent of the number of cores.

    The work must depend only on its item. `report` is called with the number of each item, in their
    order, in the caller's thread. An exception that it raises, or Ctrl-C, ends the work at the next
    `check_cancelled` of the running items. By default there is a thread for each core, but no more
    than `MOST_THREADS`; there is only one within an item that itself runs in parallel with others,
    as the cores are busy.
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
        # Each runs in a copy of the caller's context, so that the caller's cancellation ends it.
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
    """Mark the thread as one of several, so that its own work does not start more."""
    _this_thread.is_beside_others = True
