# SPDX-License-Identifier: BSD-3-Clause
"""The stage, tick by tick: what it plays, what it adds, when it stops."""

import math
from collections import deque

import numpy as np

from piezo_stage_driver.engine.blocks import (
    FLAG_FEEDBACK_HELD,
    FLAG_FEEDFORWARD_HELD,
    FLAG_PLAYING,
    FLAG_STOPPED,
    FLAG_TRACKING,
    SAMPLES_PER_BLOCK,
    Block,
    BlockCollector,
)
from piezo_stage_driver.engine.feedback_hold import FeedbackHold
from piezo_stage_driver.engine.program import Phase, Program, StageRefusal
from piezo_stage_driver.engine.ramps import Ramps
from piezo_stage_driver.engine.sources import Feedforward, Waveform
from piezo_stage_driver.engine.ticks import Ticks
from piezo_stage_driver.safety.guards import StopLatch, Stretch

LONGEST_STRETCH_SAMPLES = 16000


class StageEngine:
    """Play programs of voltages on a backend, tick by tick, within the limits.

    A program is a sequence of phases: approach and play, or track. Whatever ends it,
    the voltage returns to rest by a ramp of bounded rate.

    Parameters
    ----------
    backend : StageBackend
    limits : VoltageLimits
    rest_voltage_v : float
    ramp_rate_v_per_s : float
        Rate of every approach and return (V/s).
    samples_per_tick : int
    max_missed_feedback : int
        More answers missed in a row stop the stage.
    longest_stretch_samples : int
        How far to run between two looks at the commands while a slow waveform plays.
    sensor_guards : sequence
        Examine every stretch of samples; see `guards`.
    feedback_guard : FeedbackOscillation, optional
        Examines every answer before it acts.
    latch : StopLatch, optional
        Of a stop that outlives the engine; any thread may set it, and the next tick heeds it.
    feedback_limits : FeedbackLimits, optional
        What one answer may ask for.
    """

    def __init__(self, backend, limits, rest_voltage_v=0.0, ramp_rate_v_per_s=2000.0,
                 samples_per_tick=40, max_missed_feedback=5,
                 longest_stretch_samples=LONGEST_STRETCH_SAMPLES,
                 sensor_guards=(), feedback_guard=None, latch=None, feedback_limits=None):
        limits.check_rest(rest_voltage_v)
        self._backend = backend
        self._limits = limits
        self.rest_voltage_v = rest_voltage_v
        self._max_missed_feedback = max_missed_feedback
        self._longest_stretch_samples = longest_stretch_samples
        self._sensor_guards = sensor_guards
        self._feedback_guard = feedback_guard
        self._latch = latch or StopLatch()
        self._feedback_limits = feedback_limits
        self._ticks = Ticks(backend.sample_rate_hz, samples_per_tick)
        # A ramp that the slew limit held back would end before it is at rest.
        self._ramps = Ramps(min(ramp_rate_v_per_s, limits.slew_v_per_s), self._ticks)
        self.sample_period_s = self._ticks.sample_period_s
        self.voltage_v = rest_voltage_v
        self.next_sample = 0
        self.client = ""
        # Ticks written ahead: their voltages, and the flags of their blocks.
        lead_ticks = getattr(backend, "lead_samples", 0) // samples_per_tick
        self._ahead = deque([(np.full(samples_per_tick, rest_voltage_v), 0)] * lead_ticks)
        self.lead_ticks = lead_ticks
        self._feedforward = None
        self._feedback = None
        self._blocks = BlockCollector()
        self._program = Program()

    @property
    def tick(self):
        """The tick about to be played."""
        return self.next_sample // self._ticks.samples_per_tick

    @property
    def last_sample(self):
        """The last sample of what has been played, when it will have been measured."""
        return self.next_sample + self.lead_ticks * self._ticks.samples_per_tick - 1

    @property
    def idle(self):
        """Whether nothing is being played."""
        return self._program.over

    @property
    def at_rest(self):
        """Whether the amplifier is at rest, what is written ahead included."""
        return self.idle and self.voltage_v == self.rest_voltage_v and all(
            (voltage_v == self.rest_voltage_v).all() for voltage_v, _ in self._ahead)

    @property
    def seconds_to_rest(self):
        """What a return to rest from here would take (s)."""
        samples = self._ramps.samples(self.voltage_v, self.rest_voltage_v)
        return (samples + (self.lead_ticks + 1) * self._ticks.samples_per_tick
                ) * self.sample_period_s

    @property
    def phase_name(self):
        """Approach, play, track, return or rest."""
        return self._program.phase_name

    @property
    def fraction(self):
        """Done of the present program, 0 to 1."""
        return self._program.fraction

    @property
    def seconds_left(self):
        """Stage time left of the present program (s); infinite until a stop."""
        return self._program.samples_left * self.sample_period_s

    @property
    def stop_cause(self):
        """Why the stage is stopped; empty where it takes commands."""
        return self._latch.cause

    @property
    def missed_feedback(self):
        """Answers missed since tracking began."""
        return self._feedback.missed if self._feedback else 0

    @property
    def awaiting_answer(self):
        """Whether the next tick would miss its answer if it were played now."""
        return (self.phase_name == "track" and self._feedback is not None
                and not self.stop_cause and self._feedback.awaited(self.tick))

    # Commands

    def play(self, voltage_v, sample_period_s, repeats=1, hold_at_end=False, client=""):
        """Begin to play a waveform, after an approach from the present voltage.

        Parameters
        ----------
        voltage_v : ndarray, shape (n,)
        sample_period_s : float
            Whole multiple of the clock's period, at most 1 s.
        repeats : int
        hold_at_end : bool
            Stay at the last voltage instead of returning to rest.
        client : str
            Who asks; told to others who are refused meanwhile.

        Returns
        -------
        first_sample, samples : int
            Where the waveform lies on the sample clock.

        Raises
        ------
        LimitError, StageRefusal
        """
        self._require_ready()
        voltage_v = np.array(voltage_v, dtype=float)
        hold_samples = self._ticks.samples_per_value(sample_period_s)
        if repeats < 1:
            raise StageRefusal("repeats is 0: play the waveform at least once")
        self._limits.check(voltage_v, self.sample_period_s)
        self._limits.check(voltage_v[:1], self.sample_period_s,
                           voltage_v[-1] if repeats > 1 else None)
        self._blocks.decimation = hold_samples
        waveform = Waveform(voltage_v, hold_samples, repeats)
        approach = self._ramp("approach", voltage_v[0])
        length = self._ticks.aligned(waveform.samples, hold_samples)
        self._begin(client, Program(
            [approach, Phase("play", waveform, length, FLAG_PLAYING)],
            0 if hold_at_end else self._ramps.samples(voltage_v[-1], self.rest_voltage_v),
            hold_at_end))
        return self.last_sample + 1 + approach.samples, waveform.samples

    def load_feedforward(self, once_voltage_v, period_voltage_v, append=False):
        """Take the feedforward that ``start_tracking`` plays.

        Parameters
        ----------
        once_voltage_v, period_voltage_v : ndarray, shape (n,), (m,)
            Played once, then repeated; at the rate of the sample clock.
        append : bool
            Add ``once_voltage_v`` behind what is loaded, also while it plays.

        Raises
        ------
        LimitError, StageRefusal
        """
        once_voltage_v = np.array(once_voltage_v, dtype=float)
        if append:
            self._require_not_stopped()
            if self._feedforward is None or self._feedforward.periodic:
                raise StageRefusal("there is no streamed feedforward to append to: "
                                   "load one without a repeated part first")
            self._limits.check(once_voltage_v, self.sample_period_s,
                               self._feedforward.last_v)
            self._feedforward.append(once_voltage_v)
            return
        self._require_ready()
        feedforward = Feedforward(once_voltage_v, np.array(period_voltage_v, dtype=float))
        self._limits.check(feedforward.sequence_v, self.sample_period_s)
        self._feedforward = feedforward

    def start_tracking(self, feedback, ticks=0, client=""):
        """Play the loaded feedforward.

        Parameters
        ----------
        feedback : bool
            Add the answers to the blocks.
        ticks : int
            How long; 0 until a stop.
        client : str
            As in `play`.

        Returns
        -------
        first_tick : int

        Raises
        ------
        LimitError, StageRefusal
        """
        self._require_ready()
        if self._feedforward is None:
            raise StageRefusal("no feedforward is loaded: call load_feedforward first")
        if self._feedforward.forgotten:
            raise StageRefusal("the streamed feedforward has been played: load it again")
        self._limits.check_start(
            self._feedforward.first_v, self.voltage_v, self._ramps.v_per_tick)
        self._feedforward.rewind()
        self._feedback = None if not feedback else FeedbackHold(
            self.tick, self.lead_ticks, self._feedback_limits)
        samples = ticks * self._ticks.samples_per_tick or math.inf
        self._begin(client, Program(
            [Phase("track", self._feedforward, samples, FLAG_TRACKING)]))
        return self.tick

    def answer(self, tick, voltage_v):
        """Take the feedback that answers the block of ``tick``.

        Raises
        ------
        FeedbackError
            If it is not a finite number, or for a block to come; it then has no effect.
        """
        feedback = self._feedback  # which another thread may end meanwhile
        if feedback is not None:
            feedback.answer(tick, voltage_v, self.tick)

    def stop_tracking(self):
        """End the tracking.

        Raises
        ------
        StageRefusal
        """
        if self.phase_name != "track":
            raise StageRefusal(f"the stage does not track ({self.phase_name})")
        self.return_to_rest()

    def return_to_rest(self):
        """End the present program by a ramp to the rest voltage, unless that is done."""
        if self.phase_name == "return" or self.idle and self.voltage_v == self.rest_voltage_v:
            return
        self._feedback = None
        self._program.hold_at_end = False
        self._program.replace(self._ramp("return", self.rest_voltage_v))
        self._end_if_over()

    def stop(self, cause):
        """Ramp to rest and refuse every command until ``reset``."""
        self._latch.stop(cause)
        self.return_to_rest()

    def reset(self):
        """Take commands again after a stop.

        Raises
        ------
        StageRefusal
            While the voltage still returns to rest.
        """
        if not self.idle or self.stop_cause and self.voltage_v != self.rest_voltage_v:
            raise StageRefusal("the stage still returns to rest: reset it afterwards")
        self._latch.reset()
        self._begin_guards()

    # Time

    def advance(self):
        """Play the next samples.

        Returns
        -------
        block : Block or None
            None while a slow waveform has not filled a block.
        """
        if self.stop_cause:  # set by another thread since
            self.return_to_rest()
        feedback_v, flags = self._next_feedback()
        phase = self._program.phase(self.voltage_v)
        decimation = self._blocks.decimation
        count = self._ticks.stretch(min(SAMPLES_PER_BLOCK * decimation, phase.samples),
                                    decimation, self._longest_stretch_samples)
        flags |= phase.flag | (FLAG_STOPPED if self.stop_cause else 0)
        wanted_v = phase.source.take(count)
        if phase.name == "track":
            wanted_v = wanted_v + feedback_v
            flags |= FLAG_FEEDFORWARD_HELD if phase.source.exhausted else 0
        voltage_v, limited = self._limits.apply(wanted_v, self.voltage_v, self.sample_period_s)
        displacement_um = self._backend.exchange(voltage_v)
        self.voltage_v = float(voltage_v[-1])
        self._ahead.append((voltage_v, flags | limited))
        voltage_v, flags = self._ahead.popleft()
        self.next_sample += count
        ended = self._program.advance(count)
        block = self._collect(voltage_v, displacement_um, flags, ended is not None)
        if ended is not None and self.idle and ended.name != "return" \
                and not self._program.hold_at_end:
            self.return_to_rest()
        self._end_if_over()
        self._watch(voltage_v, displacement_um)
        return block

    def _next_feedback(self):
        """Return the feedback of the next tick and its flag; stop if it must not act."""
        if self._feedback is None:
            return 0.0, 0
        held = self._feedback.begin(self.tick)
        feedback_v = self._feedback.voltage_v
        guard = self._feedback_guard
        cause = self._feedback.cause or (guard.examine(feedback_v) if guard else "")
        if cause:
            self.stop(cause)
        return feedback_v, FLAG_FEEDBACK_HELD if held else 0

    def _watch(self, voltage_v, displacement_um):
        """Stop if a guard says so, or answers stay away."""
        stretch = Stretch.of(voltage_v, displacement_um, self._ticks.samples_per_tick)
        causes = [cause for guard in self._sensor_guards if (cause := guard.examine(stretch))]
        if self._feedback and self._feedback.missed_in_a_row > self._max_missed_feedback:
            causes.append(f"{self._feedback.missed_in_a_row} feedback answers in a row were missed")
        if causes and not self.stop_cause:
            self.stop(causes[0])

    # Programs

    def _require_not_stopped(self):
        if self.stop_cause:
            raise StageRefusal(f"the stage is stopped ({self.stop_cause}): reset it first")

    def _require_ready(self):
        self._require_not_stopped()
        if not self.idle:
            client = f" for {self.client}" if self.client else ""
            raise StageRefusal(
                f"the stage is busy ({self.phase_name}{client}): wait, or cancel that first")

    def _begin(self, client, program):
        self.client = client
        self._program = program
        self._begin_guards()

    def _begin_guards(self):
        for guard in (*self._sensor_guards, *filter(None, [self._feedback_guard])):
            guard.begin()

    def _end_if_over(self):
        if self.idle:
            self.client = ""
            self._feedback = None
            self._blocks.decimation = 1

    def _ramp(self, name, end_v):
        return self._ramps.phase(name, self.voltage_v, end_v, self._blocks.pending_samples,
                                 self._blocks.decimation)

    def _collect(self, voltage_v, displacement_um, flags, ends):
        samples, voltage_v, displacement_um, flags = self._blocks.add(
            voltage_v, displacement_um, flags, ends)
        if not samples:
            return None
        return Block(
            first_sample=self.next_sample - samples,
            sample_period_s=self._blocks.decimation * self.sample_period_s, tick=self.tick,
            voltage_v=voltage_v, displacement_um=displacement_um, flags=flags,
            missed_feedback=self.missed_feedback)
