# SPDX-License-Identifier: BSD-3-Clause
"""Commands to the loop that drives the stage: each acts once, or never."""

import math
import threading
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.safety.guards import StopLatch
from piezo_stage_driver.safety.transitions import Event

if TYPE_CHECKING:
    from piezo_stage_driver.engine.stage_commands import StageCommands


class Command:
    """A request of a client, which either acts or is refused, once.

    Parameters
    ----------
    act : callable
        Calls the requested method of the `StageCommands` that it is given.
    on_done : callable
        ``on_done(value, error)``: result of `act`, or the ValueError that refuses the command.
        Called once, in whichever thread decides.
    run : int, optional
        Number of the only run in which it may act.
    asked_s : float
        Time of the request of a reset by the monotonic clock (s); see `StopLatch.reset`.
    """

    def __init__(self, event: Event, act: Callable[["StageCommands"], Any], *,
                 on_done: Callable[[Any, ValueError | None], None], goal: Any = None,
                 run: int | None = None, asked_s: float = math.inf):
        self.event, self.act, self.goal, self.run = event, act, goal, run
        self.asked_s = asked_s
        self.expires_s = 0.0
        self._on_done = on_done
        self._claim = threading.Lock()

    def claim(self) -> bool:
        """Return True for the first caller, which alone may then run or refuse the command."""
        return self._claim.acquire(blocking=False)

    def finish(self, value: Any = None, error: ValueError | None = None) -> None:
        """Report the outcome to the client; only for the claimant of the command."""
        self._on_done(value, error)

    def reset(self, latch: StopLatch) -> None:
        """Reset a latch of a stage that is not active; only for the claimant of the command."""
        try:
            latch.reset(self.asked_s)
        except ValueError as error:
            self.finish(error=error)
        else:
            self.finish()


class CommandQueue:
    """Commands in the order of their arrival; one that has waited for too long (s) never runs."""

    def __init__(self, timeout_s: float, clock: Callable[[], float]):
        self._timeout_s, self._clock = timeout_s, clock
        self._commands: deque[Command] = deque()

    def put(self, command: Command) -> None:
        """Add a command to the queue."""
        command.expires_s = self._clock() + self._timeout_s
        self._commands.append(command)

    def take(self) -> Command | None:
        """Claim the next command that may still run; None if there is none."""
        self.expire()
        while self._commands:
            try:
                command = self._commands.popleft()
            except IndexError:  # another thread has drained it
                return None
            if command.claim():
                return command
        return None

    def expire(self) -> None:
        """Refuse the commands that have waited too long."""
        now_s = self._clock()
        for command in list(self._commands):
            if command.expires_s <= now_s and command.claim():
                command.finish(error=StageRefusal(
                    f"the stage did not carry it out within {self._timeout_s:g} s: it is "
                    "withdrawn; look at the stage's diagnostics, then ask again"))

    def drain(self, reason: str) -> None:
        """Refuse all commands in the queue."""
        while self._commands:
            try:
                command = self._commands.popleft()
            except IndexError:
                return
            if command.claim():
                command.finish(error=StageRefusal(reason))
