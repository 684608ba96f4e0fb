# SPDX-License-Identifier: BSD-3-Clause
"""Delay signals until no message is being converted."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

Handler = Callable[[int, FrameType | None], Any]


class HeldSignals:
    """Hold back SIGINT and SIGTERM while messages are handled, and process them in between.

    `rclpy` calls Python to convert a message. An exception that a signal handler raises there
    becomes a TypeError, and the message is lost. Signals without a handler in Python are not
    changed, and neither is anything in a thread that receives no signals.
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
        """Call the handler of a held signal, once; its exceptions propagate."""
        self._call(self._handlers)

    def _call(self, handlers: dict[int, Handler]) -> None:
        noted, self._noted = self._noted, []
        if noted:
            handlers[noted[-1]](noted[-1], None)

    def _note(self, number: int, _: FrameType | None) -> None:
        self._noted.append(number)
