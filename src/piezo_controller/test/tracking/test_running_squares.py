# SPDX-License-Identifier: BSD-3-Clause
import math
import sys
import threading

import pytest

from piezo_controller.tracking.tracking_run import RunningSquares


def test_the_last_samples_count():
    window = RunningSquares(100)
    assert math.isnan(window.rms)
    window.add(100 * 9.0, 100)
    assert window.rms == pytest.approx(3.0)
    for _ in range(4):
        window.add(25 * 4.0, 25)
    assert window.rms == pytest.approx(2.0)


def test_one_thread_may_ask_while_another_adds():
    window, done = RunningSquares(2000), threading.Event()

    def add():
        for _ in range(20_000):
            window.add(4.0, 1)
        done.set()

    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        adding = threading.Thread(target=add)
        adding.start()
        seen = set()
        while not done.is_set():
            seen.add(window.rms)
        adding.join()
    finally:
        sys.setswitchinterval(interval_s)
    assert {rms for rms in seen if not math.isnan(rms)} <= {2.0}
    assert window.rms == 2.0
