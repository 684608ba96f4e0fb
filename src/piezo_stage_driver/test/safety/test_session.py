# SPDX-License-Identifier: BSD-3-Clause
"""Nothing reaches a backend whose session is over."""

import numpy as np
import pytest

from piezo_stage_driver.backends.backend import BackendFault
from piezo_stage_driver.safety.session import BackendSession, SessionOver


class Backend:
    """Note every call; fail in the next exchange where that is asked for."""

    sample_rate_hz = 40_000.0

    def __init__(self):
        self.calls, self.fault = [], None

    def open(self):
        self.calls.append("open")

    def exchange(self, voltage_v):
        self.calls.append("exchange")
        if self.fault:
            raise self.fault
        return voltage_v

    def close(self):
        self.calls.append("close")


def give_up(session, backend):
    session.give_up()


def close(session, backend):
    session.close()


def fail(session, backend):
    backend.fault = BackendFault("the card is gone")
    with pytest.raises(BackendFault, match="the card is gone"):
        session.exchange(np.zeros(40))
    backend.fault = None


@pytest.mark.parametrize("end", [give_up, close, fail])
def test_session_that_is_over_lets_nothing_reach_the_backend_and_closes_it_once(end):
    backend = Backend()
    session = BackendSession(backend, clock=lambda: 0.0)
    session.open()
    end(session, backend)
    assert backend.calls[-1] == "close"
    calls = list(backend.calls)
    with pytest.raises(SessionOver, match="activate the stage again"):
        session.exchange(np.zeros(40))
    session.give_up()
    session.close()
    assert backend.calls == calls
    assert not session.busy and session.waited_s == 0.0
