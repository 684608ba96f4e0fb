# SPDX-License-Identifier: BSD-3-Clause
"""A signal acts between two messages, and never within one."""

import signal
from concurrent.futures import ThreadPoolExecutor

import pytest

from piezo_client.interrupts import HeldSignals


@pytest.fixture(params=[signal.SIGINT, signal.SIGTERM])
def number(request):
    before = signal.signal(request.param, signal.default_int_handler)
    yield request.param
    signal.signal(request.param, before)


def test_signal_waits_until_it_may_act(number):
    signals, done = HeldSignals(), []
    with pytest.raises(KeyboardInterrupt), signals.hold():
        signal.raise_signal(number)
        done.append("message in hand")
        signals.act()
        done.append("next message")
    assert done == ["message in hand"]
    assert signal.getsignal(number) is signal.default_int_handler


def test_signal_that_nobody_let_act_does_so_at_the_end(number):
    signals = HeldSignals()
    with pytest.raises(KeyboardInterrupt), signals.hold(), signals.hold():
        signal.raise_signal(number)
        signal.raise_signal(number)
    with signals.hold():
        signals.act()


def test_interrupt_outweighs_the_error_that_came_with_it(number):
    with pytest.raises(KeyboardInterrupt), HeldSignals().hold():
        signal.raise_signal(number)
        raise TypeError


def test_handler_of_ones_own_is_called_and_may_replace_itself(number):
    def once(received, _):
        signal.signal(received, signal.SIG_IGN)
        raise KeyboardInterrupt

    signal.signal(number, once)
    signals = HeldSignals()
    with pytest.raises(KeyboardInterrupt), signals.hold():
        signal.raise_signal(number)
        signals.act()
    assert signal.getsignal(number) is signal.SIG_IGN


def test_ignored_signal_stays_ignored_and_other_threads_hold_nothing(number):
    signal.signal(number, signal.SIG_IGN)
    with HeldSignals().hold():
        assert signal.getsignal(number) is signal.SIG_IGN
    signal.signal(number, signal.default_int_handler)

    def handler_within():
        with HeldSignals().hold():
            return signal.getsignal(number)

    with ThreadPoolExecutor(1) as thread:
        assert thread.submit(handler_within).result() is signal.default_int_handler
