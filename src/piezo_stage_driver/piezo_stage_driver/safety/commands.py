# SPDX-License-Identifier: BSD-3-Clause
"""Commands on their way to the loop that drives the stage: each acts once, or never."""

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from piezo_stage_driver.engine.program import StageRefusal


class Command:
    """What a client asks for, until it has acted or been refused; one of both, and once.

    Parameters
    ----------
    name : str
        Of the method of the engine.
    *arguments
    on_done : callable
        ``on_done(value, error)``: what the method returned, or the ValueError that refuses the
        command. Called once, in whichever thread decides.
    goal : Goal, optional
        Of a waveform.
    run : int, optional
        Number of the run that alone it may act in.
    """

    def __init__(self, name: str, *arguments: Any, on_done: Callable, goal: Any = None,
                 run: int | None = None):
        self.name, self.arguments, self.goal, self.run = name, arguments, goal, run
        self.expires_s = 0.0
        self._on_done = on_done
        self._claim = threading.Lock()

    def claim(self) -> bool:
        """Tell whether the caller, and nobody before, may now run or refuse the command."""
        return self._claim.acquire(blocking=False)

    def finish(self, value: Any = None, error: ValueError | None = None) -> None:
        """Tell the client; for who has claimed the command."""
        self._on_done(value, error)

    def run_by(self, method: Callable[..., Any]) -> None:
        """Call a method with the arguments, and tell the client; for who claimed the command."""
        try:
            value = method(*self.arguments)
        except ValueError as error:
            self.finish(error=error)
        else:
            self.finish(value)


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
