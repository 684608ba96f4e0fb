# SPDX-License-Identifier: BSD-3-Clause
"""The supervisor over a backend that fails or hangs at any call, whatever is asked meanwhile.

A machine of hypothesis draws what happens; what must hold at every step are its invariants. While
the backend hangs, the rest of the world acts in another thread, as in the stage node.
"""

import os
import threading

import numpy as np
from commands_by_name import command
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from piezo_models.feedback_law.feedback_law import DeclaredPlant, FeedbackLaw, LinearBlock
from piezo_stage_driver.backends.backend import BackendFault
from piezo_stage_driver.engine.feedback_hold import FeedbackError
from piezo_stage_driver.engine.stage_engine import StageEngine
from piezo_stage_driver.safety.limits import FeedbackLimits, VoltageLimits
from piezo_stage_driver.safety.supervisor import StageSupervisor
from piezo_stage_driver.safety.transitions import TRANSITIONS, State

RATE_HZ, TICK = 40_000.0, 40
LIMITS = VoltageLimits(-20.0, 120.0, 2.0e5)
LARGEST_STEP_V = 5.0 * (1 + 1e-6)
RAMP_V_PER_S = 2.0e4
FEEDBACK_LIMITS = FeedbackLimits(maximum_v=30.0, maximum_step_v=4.0, patience=2)
LEAD_TICKS = 2
# Integrates the error against a stage that follows its voltage within a sample.
FOLLOWS = DeclaredPlant(LinearBlock.of([0.0], [1.0], [1.0], [0.0]), np.ones(1))
LAW = FeedbackLaw(LinearBlock.of([1.0], [0.1], [1.0], [0.1]), np.array([0.5]), 20.0,
                  np.zeros(1), np.zeros(0), FOLLOWS, start_sample=2 * TICK)
HANG_S, EXCHANGE_TIMEOUT_S, COMMAND_TIMEOUT_S = 10.0, 2.0, 5.0
EXAMPLES = 2000 if "LONG_TESTS" in os.environ else 75

asked = st.sampled_from(
    ["play", "play and hold", "load", "append", "law", "track", "track with law", "end tracking",
     "reset"])
meanwhile = st.lists(st.one_of(asked, st.sampled_from(
    ["stop", "leave", "watch", "give up", "activate", "answer", "wait"])), max_size=5)
answers = st.tuples(
    st.integers(-3, 1), st.sampled_from([0.0, 3.0, -3.0, 29.0, 1e6, -1e308, np.nan]),
    st.sampled_from(["present", "none", "earlier", "other"]), st.booleans())


class ScriptedBackend:
    """Does what it is told, and notes every call that the contract does not allow."""

    sample_rate_hz = RATE_HZ
    lead_samples = LEAD_TICKS * TICK

    def __init__(self, world):
        self._world = world
        self.is_open = self.has_failed = False
        self.next_call = "good"
        self.given_v = np.zeros(self.lead_samples + 1)
        self.amplifier_v = 0.0
        self.meanwhile = []
        self.wrong = []

    def open(self):
        if self.is_open:
            self.wrong.append("open, though it is open")
        if self._call() == "fault":
            raise ValueError("the card is not there: plug it in")
        self.is_open, self.has_failed = True, False
        self.given_v = np.zeros(self.lead_samples + 1)
        self.amplifier_v = 0.0

    def exchange(self, voltage_v):
        if not self.is_open or self.has_failed:
            self.wrong.append(f"exchange after {'a fault' if self.has_failed else 'close'}")
        self._look_at(voltage_v)
        self.given_v = np.r_[self.given_v, voltage_v][-self.lead_samples - TICK:]
        self.amplifier_v = self.given_v[-self.lead_samples - 1]
        if self.meanwhile:
            self._hang()
        call = self._call()
        if call in ("fault", "fault off rest"):
            at_rest = call == "fault"
            self._fail()
            self.amplifier_v *= not at_rest
            raise BackendFault("the samples were lost", at_rest)
        if call == "break":
            self._fail()
            raise RuntimeError("of the vendor's library")
        if call == "short":
            self._fail()
            return np.zeros(len(voltage_v) - 1)
        return np.zeros(len(voltage_v))

    def close(self):
        if not self.is_open:
            self.wrong.append("close, though it is not open")
        self.is_open = False

    def _call(self):
        call, self.next_call = self.next_call, "good"
        return call

    def _fail(self):
        self.has_failed = True
        self._world.epoch += 1

    def _hang(self):
        actions, self.meanwhile = self.meanwhile, []
        thread = threading.Thread(target=self._world.act_meanwhile, args=(actions,), daemon=True)
        thread.start()
        thread.join(300.0)
        if thread.is_alive():
            self.wrong.append("whoever acts while the backend hangs, hangs as well")

    def _look_at(self, voltage_v):
        if not (np.isfinite(voltage_v).all() and voltage_v.min() >= LIMITS.minimum_v
                and voltage_v.max() <= LIMITS.maximum_v):
            self.wrong.append(f"out of range: {voltage_v}")
        path_v = np.r_[self.given_v[-1], voltage_v]
        if np.abs(np.diff(path_v)).max() > LARGEST_STEP_V:
            self.wrong.append(f"faster than the slew limit: {path_v}")
        if self._world.must_return and np.any(np.diff(np.abs(path_v)) > 1e-9):
            self.wrong.append(f"away from rest after a stop: {path_v}")
        if self._world.must_return and np.any(path_v[1:] * path_v[:-1] < 0):
            self.wrong.append(f"beyond rest after a stop: {path_v}")


class Asked:
    """A command and what became of it; a goal as well, if it is one."""

    def __init__(self, world, name, is_goal):
        self._world, self.name, self.is_goal = world, name, is_goal
        self.epoch = world.epoch
        self.told, self.ends = [], []
        self.cancelled = False

    def done(self, value, error):
        self.told.append((value, error))
        if error is None and self.epoch != self._world.epoch:
            self._world.wrong.append(f"{self.name} acts, asked before a fault or a stop")
        if error is not None and not str(error):
            self._world.wrong.append(f"{self.name} is refused without a cause")

    def attend(self, engine):
        pass

    def end(self, cause, last_sample):
        self.ends.append(cause)

    @property
    def wrong(self):
        """Tell what must never be, at any moment."""
        if len(self.told) > 1 or len(self.ends) > 1:
            return f"{self.name} is answered more than once: {self.told}, {self.ends}"
        if self.ends and not (self.told and self.told[0][1] is None):
            return f"{self.name} ends, but had not begun"
        return ""

    @property
    def answered(self):
        begun = bool(self.told) and self.told[0][1] is None
        return len(self.told) == 1 and len(self.ends) == (self.is_goal and begun)


class Stage(RuleBasedStateMachine):
    """A stage, its clients, its operator and its bad luck."""

    def __init__(self):
        super().__init__()
        self.now_s = 0.0
        self.epoch = 0
        self.must_return = False
        self.wrong = []
        self.asked = []
        self.backend = ScriptedBackend(self)
        self.supervisor = self.make_supervisor()

    closing_ticks = 0

    def make_supervisor(self):
        return StageSupervisor(
            self.backend, lambda backend, latch: StageEngine(
                backend, LIMITS, 0.0, RAMP_V_PER_S, TICK, latch=latch, max_missed_feedback=3,
                feedback_limits=FEEDBACK_LIMITS, longest_stretch_samples=TICK),
            exchange_timeout_s=EXCHANGE_TIMEOUT_S, command_timeout_s=COMMAND_TIMEOUT_S,
            closing_ticks=self.closing_ticks, clock=lambda: self.now_s)

    # What clients, operators and the node do

    @rule(name=asked)
    def ask(self, name):
        request = Asked(self, name, name.startswith("play"))
        self.asked.append(request)
        method, arguments = {
            "play": ("play", ([60.0, 62.0, 61.0], 1 / RATE_HZ, 200)),
            "play and hold": ("play", ([60.0], 1 / RATE_HZ, 100, True)),
            "load": ("load_feedforward", (np.linspace(0.0, 40.0, 120), [], False)),
            "append": ("append_feedforward", (np.linspace(40.0, 60.0, 40), [], True)),
            "track": ("start_tracking", (True,)),
            "law": ("load_feedback", (self.supervisor.engine.commands.checked(LAW),)),
            "track with law": ("start_tracking", (False, 0, "", True)),
            "end tracking": ("stop_tracking", ()),
            "reset": ("reset", ()),
        }[name]

        def done(value, error):
            if name == "reset" and error is None and not self.leaving:
                self.must_return = False
            request.done(value, error)

        self.supervisor.submit(command(
            method, *arguments, on_done=done, goal=request if request.is_goal else None))

    @rule()
    def stop(self):
        self.epoch += 1
        self.must_return = True
        self.supervisor.stop("somebody stopped it")

    @rule(answer=answers)
    def answer(self, answer):
        behind, voltage_v, whose, alone = answer
        run = self.supervisor._gate.run
        number = {"present": run, "none": 0, "earlier": run - 1, "other": 7}[whose]
        try:
            self.supervisor.answer(
                self.supervisor.engine.tick + behind, voltage_v, number, lambda: alone)
        except FeedbackError:
            pass

    @rule()
    def cancel(self):
        for request in self.asked[-3:]:
            request.cancelled = request.is_goal

    @precondition(lambda self: self.supervisor.state is State.INACTIVE)
    @rule(fails=st.sampled_from([False, False, False, True]))
    def activate(self, fails):
        self.backend.next_call = "fault" if fails else "good"
        self.epoch += 1
        self.leaving = False
        self.must_return = bool(self.supervisor.cause)
        try:
            self.supervisor.activate()
        except ValueError as error:
            assert str(error)
        self.backend.next_call = "good"

    leaving = False

    @rule()
    def leave(self):
        self.epoch += 1
        if self.supervisor.active:
            self.leaving = self.must_return = True
        self.supervisor.leave("the stage was deactivated")

    # Time and bad luck

    @rule(ticks=st.integers(1, 8))
    def tick(self, ticks):
        for _ in range(ticks):
            self.supervisor.tick()
            self.must_return = self.must_return or bool(self.supervisor.cause)

    @rule(seconds=st.sampled_from([0.1, 3.0, 6.0]))
    def wait(self, seconds):
        self.now_s += seconds
        self.supervisor.watch()

    @rule(call=st.sampled_from(["fault", "fault off rest", "break", "short"]))
    def fail(self, call):
        self.backend.next_call = call
        self.supervisor.tick()
        self.backend.next_call = "good"

    @rule(actions=meanwhile, then=st.sampled_from(["good", "good", "fault", "fault off rest"]))
    def hang(self, actions, then):
        self.backend.meanwhile = ["wait", *actions]
        self.backend.next_call = then
        self.supervisor.tick()
        self.backend.meanwhile, self.backend.next_call = [], "good"

    def act_meanwhile(self, actions):
        for action in actions:
            if action == "wait":
                self.now_s += HANG_S
            elif action == "give up":
                self.epoch += 1
                self.supervisor.give_up("the backend hangs")
            elif action == "activate":
                if self.supervisor.state is State.INACTIVE:
                    try:
                        self.supervisor.activate()
                    except ValueError:
                        continue
                    self.wrong.append("activated while the backend has not returned")
            elif action == "answer":
                self.answer((0, 3.0, "present", True))
            elif action in ("stop", "leave"):
                getattr(self, action)()
            elif action == "watch":
                self.supervisor.watch()
                if self.supervisor.active and not self.supervisor.cause:
                    self.wrong.append("a backend that hangs does not stop the stage")
            else:
                self.ask(action)

    # What must hold

    @invariant()
    def nothing_went_wrong(self):
        assert not self.wrong, self.wrong
        assert not self.backend.wrong, self.backend.wrong

    @invariant()
    def every_command_and_every_goal_is_answered_once(self):
        assert not any(request.wrong for request in self.asked), [r.wrong for r in self.asked]

    @invariant()
    def rest_is_told_only_where_the_amplifier_is_at_rest(self):
        if self.supervisor.at_rest:
            assert self.backend.amplifier_v == 0.0
            if self.supervisor.active:
                assert not self.backend.given_v[-self.backend.lead_samples:].any()

    @invariant()
    def backend_is_open_exactly_while_the_stage_is_active(self):
        assert self.backend.is_open == self.supervisor.active

    @invariant()
    def state_is_one_of_the_table(self):
        assert any(state is self.supervisor.state for state, _ in TRANSITIONS)

    @invariant()
    def stopped_stage_that_is_at_rest_says_that_it_is_latched(self):
        if self.supervisor.state is State.LATCHED:
            assert self.supervisor.cause
            assert self.supervisor.engine.voltage_v == 0.0

    def teardown(self):
        """Check that the stage can be left, at rest, and that everybody has an answer."""
        self.leave()
        for _ in range(2000):
            if not self.supervisor.active:
                break
            self.supervisor.tick()
        assert not self.supervisor.active
        self.now_s += HANG_S
        self.supervisor.watch()
        self.nothing_went_wrong()
        self.backend_is_open_exactly_while_the_stage_is_active()
        assert all(request.answered for request in self.asked), [
            (request.name, request.told, request.ends) for request in self.asked]


Stage.TestCase.settings = settings(
    max_examples=EXAMPLES, stateful_step_count=40, deadline=None)
TestStage = Stage.TestCase


class StageInLockstep(Stage):
    """The same where a goal ends one tick after its way back."""

    closing_ticks = LEAD_TICKS + 1


StageInLockstep.TestCase.settings = Stage.TestCase.settings
TestStageInLockstep = StageInLockstep.TestCase
