# SPDX-License-Identifier: BSD-3-Clause
"""What the stage does, who may command it, and what each fault leads to."""

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
    """Who waits for the end of a waveform; all is called from the thread that ticks."""

    def attend(self, engine: StageEngine) -> None:
        """Look how far it is; called after a tick that leaves something of its program."""

    @property
    def cancelled(self) -> bool:
        """Tell whether it shall end early."""

    def end(self, cause: str, last_sample: int) -> None:
        """Take the end, once; the cause is empty where all was played."""


class StageSupervisor:
    """The stage, without ROS and without threads of its own.

    One thread calls `tick` again and again; what it asks of the backend follows from the table in
    `transitions`. Commands, stops and answers may come from another thread at any moment: a
    command waits for the next tick, a stop acts in the next tick whatever waits.

    Parameters
    ----------
    create_engine : callable
        Takes a backend and a StopLatch; returns a StageEngine.
    latch : StopLatch, optional
        Of a stop that outlives the supervisor.
    max_foreign_feedback : int
        More answers of strangers stop the stage.
    exchange_timeout_s : float
        A backend that has not returned for longer hangs (s).
    command_timeout_s : float
        A command that the loop has not come to for longer never acts (s).
    closing_ticks : int
        Ticks that a goal lasts beyond its way back: where time then stands still, they tell
        everybody that all is over.
    clock : callable
        Returns the time (s).

    Attributes
    ----------
    engine : StageEngine
        Of the present or last activation.
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

    # What it is doing

    @property
    def state(self) -> State:
        """Tell what the stage is doing."""
        return self._state

    @property
    def cause(self) -> str:
        """Tell why the stage is stopped; empty where it is not."""
        return self._latch.cause

    @property
    def active(self) -> bool:
        """Tell whether the backend is open, and ticks are to go on."""
        return self._state not in (State.INACTIVE, State.FAULTED)

    @property
    def has_work(self) -> bool:
        """Tell whether something is to be played; stage time may stand still where not."""
        return self.active and (
            self._state in MOVING or bool(self._leaving) or not self.engine.idle
            or bool(self.cause) and self._state is not State.LATCHED)

    @property
    def hangs(self) -> bool:
        """Tell whether the backend has not returned for too long."""
        return self._session.waited_s > self._exchange_timeout_s

    @property
    def at_rest(self) -> bool:
        """Tell whether the amplifier is known to be at rest."""
        return self.engine.at_rest if self.active else self._rest_is_known

    @property
    def described(self) -> dict[str, object]:
        """Return what diagnostics tell."""
        return {"state": str(self._state), "at_rest": self.at_rest, "hangs": self.hangs,
                "foreign_feedback": self._gate.foreign, "stale_feedback": self._gate.stale}

    # Lifecycle

    def activate(self) -> None:
        """Open the backend; a stop that is latched stays so.

        Raises
        ------
        ValueError, OSError, BackendFault
            If the backend cannot be opened.
        """
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
        """Have the coming ticks return to rest and close the backend; nothing is taken any more.

        Parameters
        ----------
        cause : str
            What the client of a waveform is told.
        """
        with self._lock:
            if self.active:
                self._leaving = self._leaving or cause
            else:
                self._go(Event.LEAVE)
        self._commands.drain(NOT_ACTIVE)

    def give_up(self, cause: str, at_rest: bool = False) -> None:
        """Let nothing reach a backend that hangs any more, whenever it returns.

        Parameters
        ----------
        at_rest : bool
            Whether the backend's own way has brought the amplifier to rest.
        """
        self._session.give_up()
        self._fail(Event.GIVE_UP, cause, at_rest)

    # Commands

    def submit(self, command: Command) -> None:
        """Take a command for the next tick, or refuse it at once."""
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
        """Run the commands that wait; called by `tick`, and by whoever ticks."""
        while (command := self._commands.take()) is not None:
            self._run(command)

    def stop(self, cause: str) -> None:
        """Return to rest from the next tick on, and refuse everything until a reset.

        Whatever was asked before and has not acted yet never acts.
        """
        self._latch.stop(cause)
        self._commands.drain(f"the stage is stopped ({self.cause}): reset it first")

    def answer(self, tick: int, voltage_v: float, run: int, alone: Callable[[], bool]) -> None:
        """Take the feedback that answers the block of ``tick``.

        Parameters
        ----------
        run : int
            Number of the run that the answer is for; 0 where it bears none.
        alone : callable
            Returns whether one node alone publishes feedback.

        Raises
        ------
        FeedbackError
            If the answer may not act; where there were too many of these the stage is stopped.
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
        """Refuse commands that have waited too long, stop a stage whose backend hangs.

        Called now and then from another thread than the one that ticks.
        """
        self._commands.expire()
        if self.hangs and self.active:
            self.stop(f"the backend has not returned for {self._exchange_timeout_s:g} s")

    # Time

    def tick(self, whole_block: bool = False) -> Block | None:
        """Run what waits, play the next samples.

        Parameters
        ----------
        whole_block : bool
            Play on until a block is full, as long as nobody has to answer; for who takes no
            commands meanwhile.

        Returns
        -------
        block : Block or None
            None while a slow waveform has not filled a block, and after a fault.
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
            return None  # given up: who did that has told why
        except BackendFault as fault:
            self._fail(Event.FAULT, str(fault), fault.at_rest)
            return None
        with self._lock:
            if not self.active:
                return None
            if self._goal and not self.engine.idle:  # its program is over in the closing ticks
                self._goal.attend(self.engine)
            self._idle_ticks = self._idle_ticks + 1 if was_idle else 0
            self._follow()
        return block

    def _prepare(self) -> bool:
        """Begin the way to rest where that is asked for; return whether there is more to play."""
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
                self._follow()  # what the command before has left, with no tick between the two
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
        """Go from state to state as the engine did."""
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
        except Exception as error:  # the stage is at rest: there is nothing left but to tell
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
