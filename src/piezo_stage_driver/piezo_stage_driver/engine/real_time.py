# SPDX-License-Identifier: BSD-3-Clause
"""Real-time operation of a process: priority, locked memory, and no pauses for collections."""

import contextlib
import ctypes
import gc
import os
import resource
import sys
import threading

# Of sys/mman.h: lock present and future mappings, each page from its first use on.
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4
# Longest time for which another thread of this process may keep the interpreter (s).
SWITCH_INTERVAL_S = 2e-4


class RealTime:
    """Real-time operation of the process between `begin` and `end`, as far as the system allows it.

    All threads of the process get a real-time priority, because each of them holds the interpreter
    or a lock of the middleware at times: if it were preempted, it would block the loop. The
    priority of the loop, 1 to 99, is higher by one; 0 requests nothing, and does not lock the
    memory. `status` tells what the system has granted; or what it has refused, and what to do.
    """

    def __init__(self, priority: int) -> None:
        self._priority = priority
        self._switch_interval_s = sys.getswitchinterval()
        self._raised: set[int] = set()
        self._locked = self._begun = False
        self.status = "not requested"

    def begin(self) -> None:
        """Raise the priority of all threads, lock the memory, and stop long garbage collections.

        Called before the thread of the loop starts.
        """
        self._begun = True
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        # Objects that exist by now persist, so collections need not examine them.
        gc.collect()
        gc.freeze()
        if self._priority:
            refused = self._raise_threads(), self._lock_memory()
            self.status = "; ".join(filter(None, refused)) or "granted"

    def raise_loop(self) -> None:
        """Raise the priority of the calling thread above that of the others."""
        if self._raised:
            self._raised.add(threading.get_native_id())
            _set_priority(0, self._priority)

    def raise_new_threads(self) -> None:
        """Raise the priority of new threads, if the system allows it.

        Called from time to time from another thread than the loop's, as the executor and the
        middleware start some threads only when they need them.
        """
        if self._raised:
            self._raise_threads()

    def end(self) -> None:
        """Undo `begin`, unless that is done."""
        if not self._begun:
            return
        self._begun = False
        for thread in self._raised:
            with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
        self._raised = set()
        if self._locked:
            ctypes.CDLL(None).munlockall()
            self._locked = False
        gc.unfreeze()
        sys.setswitchinterval(self._switch_interval_s)

    def _raise_threads(self) -> str:
        present = set(map(int, os.listdir("/proc/self/task")))
        try:
            for thread in present - self._raised:
                with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
                    _set_priority(thread, max(self._priority - 1, 1))
                    self._raised.add(thread)
        except OSError as error:
            return (f"the priority is not raised ({error.strerror}): let the user have one of "
                    f"{self._priority} (rtprio in /etc/security/limits.conf)")
        return ""

    def _lock_memory(self) -> str:
        advice = "let the user lock all memory (memlock unlimited in /etc/security/limits.conf)"
        limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
        if os.geteuid() and limit != resource.RLIM_INFINITY:
            # Below a limit locking may succeed, but later allocations then fail.
            return f"the memory is not locked (there is a limit): {advice}"
        library = ctypes.CDLL(None, use_errno=True)
        if library.mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT):
            return f"the memory is not locked ({os.strerror(ctypes.get_errno())}): {advice}"
        self._locked = True
        return ""


def _set_priority(thread: int, priority: int) -> None:
    # Threads and processes that it starts do not inherit the priority.
    os.sched_setscheduler(thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK,
                          os.sched_param(priority))
