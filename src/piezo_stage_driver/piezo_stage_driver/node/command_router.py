# SPDX-License-Identifier: BSD-3-Clause
"""Where commands and stops go, whether the stage is configured or not."""

from collections.abc import Callable

import numpy.typing as npt

from piezo_models.feedback_law.feedback_law import FeedbackLaw
from piezo_stage_driver.engine.onboard_feedback import CheckedLaw
from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.engine.stage_commands import Replacement
from piezo_stage_driver.safety.commands import Command
from piezo_stage_driver.safety.guards import StopLatch
from piezo_stage_driver.safety.supervisor import NOT_ACTIVE, StageSupervisor
from piezo_stage_driver.safety.transitions import Event


class CommandRouter:
    """Pass commands and stops on to the supervisor; answer them where there is none yet.

    Parameters
    ----------
    lockstep : bool
        Whether commands act between two callbacks: the supervisor need not wait for a tick.
    latch : StopLatch
        Of stops, which outlive the supervisor.
    tell_stop : callable
        Called once the stage has been stopped.

    Attributes
    ----------
    supervisor : StageSupervisor or None
        Of the stage that is configured.
    """

    def __init__(self, lockstep: bool, latch: StopLatch, tell_stop: Callable[[], None]) -> None:
        self._lockstep, self._latch, self._tell_stop = lockstep, latch, tell_stop
        self.supervisor: StageSupervisor | None = None

    @property
    def at_rest(self) -> bool:
        """Whether the amplifier is known to be at rest; it is before anything was configured."""
        return self.supervisor is None or self.supervisor.at_rest

    @property
    def can_come_to_rest(self) -> bool:
        """Whether the stage still drives the amplifier."""
        return self.supervisor is not None and self.supervisor.active

    @property
    def seconds_to_rest(self) -> float:
        """What a return to rest would take from here (s)."""
        supervisor = self.supervisor
        return supervisor.engine.seconds_to_rest if supervisor and supervisor.active else 0.0

    def checked(self, law: FeedbackLaw) -> CheckedLaw:
        """Check a feedback law for the stage that is configured.

        Raises
        ------
        FeedbackLawError, StageRefusal
            The law must not act, or there is no stage.
        """
        if self.supervisor is None:
            raise StageRefusal(NOT_ACTIVE)
        return self.supervisor.engine.commands.checked(law)

    def replacement(self, once_voltage_v: npt.ArrayLike, period_voltage_v: npt.ArrayLike,
                    law: FeedbackLaw | None) -> Replacement:
        """Check what is to take the place of a feedforward and its law within a run.

        Raises
        ------
        LimitError, FeedbackLawError, StageRefusal
            It must not act, or there is no stage.
        """
        if self.supervisor is None:
            raise StageRefusal(NOT_ACTIVE)
        return self.supervisor.engine.commands.replacement(once_voltage_v, period_voltage_v, law)

    def submit(self, command: Command) -> None:
        """Have a command run between two ticks, or refused; it tells by itself which."""
        if self.supervisor is not None:
            self.supervisor.submit(command)
            if self._lockstep:
                self.supervisor.attend()
        elif command.event is Event.RESET:
            command.reset(self._latch)
        else:
            command.finish(error=StageRefusal(NOT_ACTIVE))

    def stop(self, cause: str) -> None:
        """Stop from whatever state, until somebody resets it."""
        if self.supervisor is not None:
            self.supervisor.stop(cause)
        self._latch.stop(cause)
        self._tell_stop()
