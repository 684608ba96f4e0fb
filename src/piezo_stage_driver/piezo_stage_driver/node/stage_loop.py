# SPDX-License-Identifier: BSD-3-Clause
"""The loop that advances a configured stage, and brings it to rest in the end."""

import threading
import time
from collections.abc import Callable

from piezo_stage_driver.backends.backend import StageBackend
from piezo_stage_driver.engine.blocks import Block
from piezo_stage_driver.engine.real_time import RealTime
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.node.stage_settings import StageSettings
from piezo_stage_driver.safety.supervisor import StageSupervisor

IDLE_WAIT_S = 0.05


class StageLoop:
    """The ticks of one configured stage.

    A paced stage ticks in its own thread while it is active. A stage in lockstep ticks in `step`,
    only while something plays; each tick that needs an answer waits for it. After the ticks, the
    ticking thread calls `report_stop`, to report a stop that has occurred since, and `settle`, to
    answer the clients that wait for rest.
    """

    def __init__(self, supervisor: StageSupervisor, backend: StageBackend,
                 settings: StageSettings, publish: Callable[[Block], None],
                 report_stop: Callable[[], None], settle: Callable[[], None]) -> None:
        self.supervisor = supervisor
        self._backend, self._settings = backend, settings
        self._publish, self._report_stop, self._settle = publish, report_stop, settle
        self.real_time = RealTime(settings.real_time_priority)
        self._thread: threading.Thread | None = None
        self._own_rest: threading.Thread | None = None
        self._failure: Exception | None = None
        self._answer_deadline_s: float | None = None
        self._leaving = self._published = False

    @property
    def engine(self) -> StageEngine:
        """Engine of the present or last activation."""
        return self.supervisor.engine

    @property
    def active(self) -> bool:
        """Whether the stage accepts commands: it is active, and not being left."""
        return self.supervisor.active and not self._leaving

    def begin(self) -> None:
        """Start the ticks, once the supervisor is active."""
        self._failure = self._own_rest = None
        self._leaving = False
        if not self._settings.lockstep:
            self.real_time.begin()
            # A daemon, as a backend that never returns must not prevent the process from ending.
            self._thread = threading.Thread(target=self._run, name="stage loop", daemon=True)
            self._thread.start()

    def step(self) -> float:
        """Advance a stage in lockstep; return how long to wait for the next callback (s).

        Raises the exception that ended the thread of a paced stage, if there was one.
        """
        if self._failure is not None:
            raise self._failure
        if not self._settings.lockstep or not self.supervisor.has_work:
            return IDLE_WAIT_S
        if self.engine.awaiting_answer:
            now_s = time.monotonic()
            if self._answer_deadline_s is None:
                self._answer_deadline_s = now_s + self._settings.lockstep_timeout_s
            if now_s < self._answer_deadline_s:
                return min(IDLE_WAIT_S, self._answer_deadline_s - now_s)
        self._answer_deadline_s = None
        self._advance()
        # Commands need no attention within a block that nobody answers.
        while not self._published and self.supervisor.has_work and not self.engine.awaiting_answer:
            self._advance()
        return 0.0

    def watch(self) -> None:
        """Monitor the loop from another thread: new threads and commands, and a hanging backend."""
        self.supervisor.watch()
        self.real_time.raise_new_threads()
        if self.supervisor.hangs:
            self._begin_own_rest()

    def leave(self, cause: str) -> None:
        """Return to rest and stop the sample clock; return once that is done or given up."""
        supervisor = self.supervisor
        self._leaving = True
        supervisor.leave(cause)
        while supervisor.active:
            if self._thread is None or not self._thread.is_alive():
                self._advance()
                continue
            self._thread.join(IDLE_WAIT_S)
            if supervisor.hangs:
                self._rest_without_thread(cause)
        if not supervisor.hangs and self._thread is not None:
            self._thread.join()
        self._thread = None
        self.real_time.end()
        supervisor.leave(cause)
        self._settle()

    def _run(self) -> None:
        try:
            self.real_time.raise_loop()
            while self.supervisor.active:
                self._advance()
        except Exception as error:  # of any kind: the main thread handles it
            self._failure = error

    def _advance(self) -> None:
        supervisor = self.supervisor
        was_idle = supervisor.engine.idle
        self._tick()
        self._report_stop()
        if self._settings.lockstep and supervisor.engine.idle and not was_idle:
            # Time stops after this, so the last block must report that the stage is at rest.
            for _ in range(supervisor.engine.lead_ticks + 1 + supervisor.engine.holds_block):
                self._tick()
        self._settle()

    def _tick(self) -> None:
        block = self.supervisor.tick(whole_block=self._settings.lockstep)
        self._published = block is not None
        if block is not None:
            self._publish(block)

    def _rest_without_thread(self, cause: str) -> None:
        """Give up a backend that hangs while the stage is left."""
        self._begin_own_rest()
        if self._own_rest is not None:
            self._own_rest.join(self._settings.exchange_timeout_s)
        self.supervisor.give_up(f"{cause} while its backend hung: cut the amplifier's supply")

    def _begin_own_rest(self) -> None:
        """Call a hanging backend's own return to rest, if it has one, once."""
        emergency_rest = getattr(self._backend, "emergency_rest", None)
        if self._own_rest is None and emergency_rest is not None:
            self._own_rest = threading.Thread(
                target=self._rest_by_backend, args=(emergency_rest,), name="own rest", daemon=True)
            self._own_rest.start()

    def _rest_by_backend(self, emergency_rest: Callable[[], None]) -> None:
        try:
            emergency_rest()
        except Exception as error:  # of a vendor's library
            self.supervisor.give_up(f"the backend hangs, and cannot come to rest: {error}")
        else:
            self.supervisor.give_up("the backend hung, and the amplifier went to rest",
                                    at_rest=True)
