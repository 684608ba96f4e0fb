# SPDX-License-Identifier: BSD-3-Clause
"""What the system grants is taken and given back; what it refuses is told."""

import gc
import os
import resource
import sys
import threading

import pytest

from piezo_stage_driver.engine import real_time
from piezo_stage_driver.engine.real_time import SWITCH_INTERVAL_S, RealTime


@pytest.fixture
def system(monkeypatch):
    """A system that grants everything, and keeps what it was asked for."""
    asked = {"priorities": {}, "locked": None}

    class Library:
        def mlockall(self, flags):
            asked["locked"] = flags
            return 0

        def munlockall(self):
            asked["locked"] = None

    monkeypatch.setattr(os, "sched_setscheduler", lambda thread, policy, parameter: asked[
        "priorities"].__setitem__(thread, (policy, parameter.sched_priority)))
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(real_time.ctypes, "CDLL", lambda name, use_errno=False: Library())
    return asked


def test_every_thread_is_raised_and_the_loop_above_them_until_the_end(system):
    mine, real = threading.get_native_id(), RealTime(40)
    real.begin()
    real.raise_loop()
    fifo = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    assert system["priorities"][mine] == (fifo, 39)
    assert system["priorities"][0] == (fifo, 40)
    assert system["locked"] and real.status == "granted"
    assert sys.getswitchinterval() == pytest.approx(SWITCH_INTERVAL_S)
    assert gc.get_freeze_count() > 0
    for _ in range(2):
        real.end()
        assert system["priorities"][mine] == (os.SCHED_OTHER, 0)
        assert system["locked"] is None and gc.get_freeze_count() == 0
        assert sys.getswitchinterval() == pytest.approx(0.005)


def test_thread_that_comes_later_is_raised_too_and_the_loop_stays_above(system, monkeypatch):
    real, loop, later = RealTime(40), threading.get_native_id(), 4_000_000
    threads = [loop]
    monkeypatch.setattr(os, "listdir", lambda path: list(map(str, threads)))
    real.begin()
    real.raise_loop()
    system["priorities"].clear()
    threads.append(later)
    real.raise_new_threads()
    assert system["priorities"] == {later: (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 39)}
    real.end()
    assert system["priorities"][later] == (os.SCHED_OTHER, 0)
    system["priorities"].clear()
    real.raise_new_threads()
    assert not system["priorities"]


def test_thread_that_ends_meanwhile_is_no_refusal(system, monkeypatch):
    def end(thread, policy, parameter):
        raise ProcessLookupError(3, "No such process")

    monkeypatch.setattr(os, "sched_setscheduler", end)
    real = RealTime(40)
    real.begin()
    assert real.status == "granted"
    real.end()


def test_no_priority_asks_the_system_for_nothing(system):
    real = RealTime(0)
    real.begin()
    real.raise_loop()
    assert system == {"priorities": {}, "locked": None}
    assert real.status == "not requested"
    real.end()


def test_what_the_system_refuses_is_told_with_what_to_do(system, monkeypatch):
    def refuse(thread, policy, parameter):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(resource, "getrlimit", lambda which: (8 << 20, 8 << 20))
    real = RealTime(40)
    real.begin()
    real.raise_loop()
    assert "the priority is not raised (Operation not permitted): let" in real.status
    assert "the memory is not locked (there is a limit): let" in real.status
    assert system["locked"] is None
    real.end()
