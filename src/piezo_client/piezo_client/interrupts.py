# SPDX-License-Identifier: BSD-3-Clause
"""Signals that wait for a moment in which the middleware has nothing in hand."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

Handler = Callable[[int, FrameType | None], Any]


class HeldSignals:
    """Note SIGINT and SIGTERM while messages are handled, and let them act in between.

    `rclpy` calls Python to convert a message. An exception that a signal's handler raises in there
    comes out as a TypeError, and the message is lost. A signal without a handler in Python is left
    alone, and so is everything in a thread that gets no signals.
    """

    def __init__(self) -> None:
        self._handlers: dict[int, Handler] = {}
        self._noted: list[int] = []

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Hold signals back until the block ends or `act` is called."""
        if self._handlers or threading.current_thread() is not threading.main_thread():
            yield
            return
        for number in (signal.SIGINT, signal.SIGTERM):
            if callable(handler := signal.getsignal(number)):
                self._handlers[number] = handler
                signal.signal(number, self._note)
        try:
            yield
        finally:
            handlers, self._handlers = self._handlers, {}
            for held, handler in handlers.items():
                if signal.getsignal(held) == self._note:
                    signal.signal(held, handler)
            self._call(handlers)

    def act(self) -> None:
        """Call the handler of a signal that was noted, once; what it raises is the caller's."""
        self._call(self._handlers)

    def _call(self, handlers: dict[int, Handler]) -> None:
        noted, self._noted = self._noted, []
        if noted:
            handlers[noted[-1]](noted[-1], None)

    def _note(self, number: int, _: FrameType | None) -> None:
        self._noted.append(number)
