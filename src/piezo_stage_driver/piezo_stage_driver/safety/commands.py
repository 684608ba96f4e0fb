# SPDX-License-Identifier: BSD-3-Clause
"""Commands on their way to the loop that drives the stage: each acts once, or never."""

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
    """What a client asks for, until it has acted or been refused; one of both, and once.

    Parameters
    ----------
    event : Event
        That it is; one of `transitions.COMMANDS`.
    act : callable
        Calls what it asks for, of the `StageCommands` that it is given.
    on_done : callable
        ``on_done(value, error)``: what `act` returned, or the ValueError that refuses the command.
        Called once, in whichever thread decides.
    goal : Goal, optional
        Of a waveform.
    run : int, optional
        Number of the run that alone it may act in.
    asked_s : float
        When a reset was asked for, by the monotonic clock (s); see `StopLatch.reset`.
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
        """Tell whether the caller, and nobody before, may now run or refuse the command."""
        return self._claim.acquire(blocking=False)

    def finish(self, value: Any = None, error: ValueError | None = None) -> None:
        """Tell the client; for who has claimed the command."""
        self._on_done(value, error)

    def reset(self, latch: StopLatch) -> None:
        """Reset a latch of a stage that is not active; for who has claimed the command."""
        try:
            latch.reset(self.asked_s)
        except ValueError as error:
            self.finish(error=error)
        else:
            self.finish()


class CommandQueue:
    """Commands in the order in which they came.

    Parameters
    ----------
    timeout_s : float
        A command that has waited for longer is refused and never runs.
    clock : callable
        Returns the time (s).
    """

    def __init__(self, timeout_s: float, clock: Callable[[], float]):
        self._timeout_s, self._clock = timeout_s, clock
        self._commands: deque[Command] = deque()

    def put(self, command: Command) -> None:
        """Let a command wait for the loop."""
        command.expires_s = self._clock() + self._timeout_s
        self._commands.append(command)

    def take(self) -> Command | None:
        """Claim the next command that may still run; None where there is none."""
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
        """Refuse what has waited too long."""
        now_s = self._clock()
        for command in list(self._commands):
            if command.expires_s <= now_s and command.claim():
                command.finish(error=StageRefusal(
                    f"the stage has not got round to it within {self._timeout_s:g} s: it will not "
                    "act any more; look at the stage's diagnostics, then ask again"))

    def drain(self, reason: str) -> None:
        """Refuse everything that waits."""
        while self._commands:
            try:
                command = self._commands.popleft()
            except IndexError:
                return
            if command.claim():
                command.finish(error=StageRefusal(reason))
