# SPDX-License-Identifier: BSD-3-Clause
"""Routing of commands and stops, whether or not the stage is configured."""

from collections.abc import Callable

from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.engine.stage_commands import StageCommands
from piezo_stage_driver.safety.commands import Command
from piezo_stage_driver.safety.guards import StopLatch
from piezo_stage_driver.safety.supervisor import NOT_ACTIVE, StageSupervisor
from piezo_stage_driver.safety.transitions import Event


class CommandRouter:
    """Pass commands and stops on to the `supervisor`; answer them if there is none yet.

    In lockstep, commands act between two callbacks, so that the supervisor need not wait for a
    tick. The latch of the stops outlives the supervisor; `report_stop` is called after a stop.
    """

    def __init__(self, lockstep: bool, latch: StopLatch, report_stop: Callable[[], None]) -> None:
        self._lockstep, self._latch, self._report_stop = lockstep, latch, report_stop
        self.supervisor: StageSupervisor | None = None

    @property
    def at_rest(self) -> bool:
        """Whether the amplifier is known to be at rest; True before the stage is configured."""
        return self.supervisor is None or self.supervisor.at_rest

    @property
    def can_come_to_rest(self) -> bool:
        """Whether the stage still drives the amplifier."""
        return self.supervisor is not None and self.supervisor.active

    @property
    def seconds_to_rest(self) -> float:
        """Return the time that a return to rest would take now (s)."""
        supervisor = self.supervisor
        return supervisor.engine.seconds_to_rest if supervisor and supervisor.active else 0.0

    @property
    def checks(self) -> StageCommands:
        """Return the configured stage, to check what a command brings, from any thread.

        Raises `StageRefusal` if there is none.
        """
        if self.supervisor is None:
            raise StageRefusal(NOT_ACTIVE)
        return self.supervisor.engine.commands

    def submit(self, command: Command) -> None:
        """Let a command run between two ticks, or refuse it; the command reports the outcome."""
        if self.supervisor is not None:
            self.supervisor.submit(command)
            if self._lockstep:
                self.supervisor.attend()
        elif command.event is Event.RESET:
            command.reset(self._latch)
        else:
            command.finish(error=StageRefusal(NOT_ACTIVE))

    def stop(self, cause: str) -> None:
        """Stop in any state, until the stop is reset."""
        if self.supervisor is not None:
            self.supervisor.stop(cause)
        self._latch.stop(cause)
        self._report_stop()
