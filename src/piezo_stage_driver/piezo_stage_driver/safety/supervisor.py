# SPDX-License-Identifier: BSD-3-Clause
"""The state of the stage, the commands that it accepts, and the effects of faults."""

import threading
import time
from collections.abc import Callable
from typing import Protocol

from piezo_stage_driver.backends.backend import BackendFault, StageBackend
from piezo_stage_driver.engine.blocks import Block
from piezo_stage_driver.engine.feedback_hold import FeedbackError
from piezo_stage_driver.engine.program import StageRefusal
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.answer_gate import AnswerGate
from piezo_stage_driver.safety.commands import Command, CommandQueue
from piezo_stage_driver.safety.guards import StopLatch
from piezo_stage_driver.safety.session import BackendSession, SessionOver
from piezo_stage_driver.safety.transitions import MOVING, TRANSITIONS, Event, State

NOT_ACTIVE = "the stage is not active: activate it first"
UNSAFE = "the amplifier may still be under voltage: cut its supply"


class Goal(Protocol):
    """A client that waits for the end of a waveform; called from the ticking thread."""

    def attend(self, engine: StageEngine) -> None:
        """Report the progress; called after each tick that does not end the program."""

    @property
    def cancelled(self) -> bool:
        """Return whether the goal is cancelled."""

    def end(self, cause: str, last_sample: int) -> None:
        """Handle the end, once; the cause is empty if everything was played."""


class StageSupervisor:
    """The stage, without ROS and without threads.

    One thread calls `tick` repeatedly; its calls of the backend follow from the table in
    `transitions`. Commands, stops and answers may come from another thread at any time: a command
    waits for the next tick, a stop acts in the next tick in any case.

    Parameters
    ----------
    create_engine : callable
        Takes a backend and a StopLatch; returns a StageEngine.
    latch : StopLatch, optional
        Latch of the stops, which outlives the supervisor.
    max_foreign_feedback : int
        Largest number of answers of other clients; more stop the stage.
    exchange_timeout_s : float
        Time after which a call of the backend counts as hanging (s).
    command_timeout_s : float
        Time after which a waiting command never acts (s).
    closing_ticks : int
        Ticks that a goal lasts beyond its return to rest. If time stops after it, they report the
        end to all subscribers.

    Attributes
    ----------
    engine : StageEngine
        Engine of the present or last activation.
    """

    def __init__(self, backend: StageBackend,
                 create_engine: Callable[[StageBackend, StopLatch], StageEngine],
                 latch: StopLatch | None = None, max_foreign_feedback: int = 0,
                 exchange_timeout_s: float = 2.0, command_timeout_s: float = 5.0,
                 closing_ticks: int = 0, clock: Callable[[], float] = time.monotonic):
        self._backend, self._create_engine = backend, create_engine
        self._latch = latch or StopLatch()
        self._exchange_timeout_s, self._clock = exchange_timeout_s, clock
        self._commands = CommandQueue(command_timeout_s, clock)
        self._gate = AnswerGate(max_foreign_feedback)
        self._lock = threading.RLock()
        self._state = State.INACTIVE
        self._leaving = ""
        self._goal: Goal | None = None
        self._closing_ticks, self._idle_ticks = closing_ticks, 0
        self._rest_is_known = True
        self._session = BackendSession(backend, clock)
        self.engine = create_engine(self._session, self._latch)

    # State

    @property
    def state(self) -> State:
        """Return the state of the stage."""
        return self._state

    @property
    def cause(self) -> str:
        """Return why the stage is stopped; empty if it is not."""
        return self._latch.cause

    @property
    def active(self) -> bool:
        """Return whether the backend is open and ticks must continue."""
        return self._state not in (State.INACTIVE, State.FAULTED)

    @property
    def has_work(self) -> bool:
        """Return whether something is to be played; otherwise stage time may stop."""
        return self.active and (
            self._state in MOVING or bool(self._leaving) or not self.engine.idle
            or bool(self.cause) and self._state is not State.LATCHED)

    @property
    def hangs(self) -> bool:
        """Return whether a call of the backend has lasted too long."""
        return self._session.waited_s > self._exchange_timeout_s

    @property
    def at_rest(self) -> bool:
        """Return whether the amplifier is known to be at rest."""
        return self.engine.at_rest if self.active else self._rest_is_known

    @property
    def described(self) -> dict[str, object]:
        """Return the entries for the diagnostics."""
        return {"state": str(self._state), "at_rest": self.at_rest, "hangs": self.hangs,
                "foreign_feedback": self._gate.foreign, "stale_feedback": self._gate.stale}

    # Lifecycle

    def activate(self) -> None:
        """Open the backend; a latched stop persists. Raises as `StageBackend.open`."""
        if self._session.busy:
            raise ValueError("the backend has not returned from its last call: cut the "
                             "amplifier's supply, then start the node again")
        self._commands.drain(NOT_ACTIVE)
        session = BackendSession(self._backend, self._clock)
        engine = self._create_engine(session, self._latch)
        session.open()
        with self._lock:
            self._session, self.engine = session, engine
            self._leaving = ""
            self._go(Event.ACTIVATE)
            self._follow()

    def leave(self, cause: str) -> None:
        """Let the next ticks return to rest and close the backend; refuse commands from now on."""
        with self._lock:
            if self.active:
                self._leaving = self._leaving or cause
            else:
                self._go(Event.LEAVE)
        self._commands.drain(NOT_ACTIVE)

    def give_up(self, cause: str, at_rest: bool = False) -> None:
        """Block all further calls of a hanging backend, which itself may have come to rest."""
        self._session.give_up()
        self._fail(Event.GIVE_UP, cause, at_rest)

    # Commands

    def submit(self, command: Command) -> None:
        """Queue a command for the next tick, or refuse it at once."""
        with self._lock:
            takes = self.active and not self._leaving
            if takes:
                self._commands.put(command)
        if takes or not command.claim():
            return
        if command.event is Event.RESET and not self.active:
            command.reset(self._latch)
        else:
            command.finish(error=StageRefusal(NOT_ACTIVE))

    def attend(self) -> None:
        """Run the commands that wait; called by `tick`, and by the ticking thread."""
        while (command := self._commands.take()) is not None:
            self._run(command)

    def stop(self, cause: str) -> None:
        """Return to rest from the next tick on, and refuse all commands until a reset.

        Earlier commands that have not acted yet never act.
        """
        self._latch.stop(cause)
        self._commands.drain(f"the stage is stopped ({self.cause}): reset it first")

    def answer(self, tick: int, voltage_v: float, run: int, alone: Callable[[], bool]) -> None:
        """Take the feedback that answers the block of ``tick`` in a run; 0 if it has no run number.

        `alone` returns whether a single node publishes feedback. Raises `FeedbackError` if the
        answer may not act; too many of these stop the stage.
        """
        if self._state is not State.TRACKING:
            return
        if self._gate.admits(run, run == 0 and alone()):
            self.engine.answer(tick, voltage_v)
            return
        if self._gate.cause:
            self.stop(self._gate.cause)
        raise FeedbackError(f"the feedback for tick {tick} bears run {run}, not {self._gate.run}: "
                            "send the number that start_tracking returned")

    def watch(self) -> None:
        """Refuse commands that have waited too long, and stop a stage whose backend hangs.

        Called from time to time from another thread than the ticking one.
        """
        self._commands.expire()
        if self.hangs and self.active:
            self.stop(f"the backend has not returned for {self._exchange_timeout_s:g} s")

    # Time

    def tick(self, whole_block: bool = False) -> Block | None:
        """Run the waiting commands, and play the next samples; return a block once it is full.

        Callers without commands meanwhile play on until a whole block is full, if no answer is
        needed. No block is returned after a fault.
        """
        self.attend()
        if not self._prepare():
            return None
        was_idle = self.engine.idle
        try:
            block = self.engine.advance()
            while whole_block and block is None and self.engine.tracks_alone:
                block = self.engine.advance()
        except SessionOver:
            return None  # given up; the cause has been reported
        except BackendFault as fault:
            self._fail(Event.FAULT, str(fault), fault.at_rest)
            return None
        with self._lock:
            if not self.active:
                return None
            if self._goal and not self.engine.idle:  # in the closing ticks its program is over
                self._goal.attend(self.engine)
            self._idle_ticks = self._idle_ticks + 1 if was_idle else 0
            self._follow()
        return block

    def _prepare(self) -> bool:
        """Begin the return to rest if it was requested; return whether there is more to play."""
        with self._lock:
            if self.active:
                if self.cause or self._leaving or self._goal and self._goal.cancelled:
                    self.engine.return_to_rest()
                self._follow()
            return self.active

    def _run(self, command: Command) -> None:
        event = command.event
        try:
            with self._lock:
                if not self.active or self._leaving:
                    raise StageRefusal(NOT_ACTIVE)
                self._follow()  # the effect of the previous command, without a tick in between
                if command.run not in (None, self._gate.run):
                    raise StageRefusal(f"run {command.run} does not go on: send the number that "
                                       "start_tracking returned for the present one")
                value = command.act(self.engine.commands)
                if event is Event.TRACK:
                    value = self._gate.begin(), value
                if event in (Event.PLAY, Event.TRACK):  # another program begins
                    self._end_goal()
                if event is Event.PLAY:
                    self._goal, self._idle_ticks = command.goal, 0
                self._go(event)
        except ValueError as error:
            command.finish(error=error)
        else:
            command.finish(value)

    def _follow(self) -> None:
        """Update the state from that of the engine."""
        engine = self.engine
        if self._leaving:
            if self._state is not State.STOPPING:
                self._go(Event.LEAVE)
        elif self.cause:
            if self._state not in (State.STOPPING, State.LATCHED):
                self._go(Event.STOP)
        elif self._state in (State.PLAYING, State.TRACKING):
            if engine.idle:
                self._go(Event.OVER)
            elif engine.phase_name == "return":
                self._go(Event.RETURN)
        if engine.idle:
            if self._idle_ticks >= self._closing_ticks:
                self._end_goal()
            if self._state is State.STOPPING:
                self._come_to_rest()

    def _come_to_rest(self) -> None:
        if self._leaving:
            if self.engine.at_rest:
                self._close()
        elif self.cause:
            if self.engine.has_returned:
                self._go(Event.REST_LATCHED)
        else:
            self._go(Event.REST)

    def _close(self) -> None:
        self._rest_is_known = True
        self._end_goal()
        try:
            self._session.close()
        except Exception as error:  # the stage is at rest, so it only remains to report this
            self._latch.stop(f"the backend failed to close: {error!r}")
        self._go(Event.REST_LEAVING)

    def _end_goal(self) -> None:
        goal, self._goal = self._goal, None
        if goal:
            goal.end(self.cause or self._leaving, self.engine.last_sample)

    def _fail(self, event: Event, cause: str, at_rest: bool) -> None:
        with self._lock:
            if not self.active:
                return
            self._latch.stop(cause)
            self._rest_is_known = at_rest
            self._go(event)
            self._end_goal()
        self._commands.drain(f"the stage is stopped ({self.cause}): reset it first")

    def _go(self, event: Event) -> None:
        self._state = TRANSITIONS[self._state, event].to
