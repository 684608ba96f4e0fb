# SPDX-License-Identifier: BSD-3-Clause
"""The engine of the stage: plays programs, adds feedback, and stops, tick by tick."""

from collections import deque

import numpy as np

from piezo_stage_driver.backends.backend import StageBackend
from piezo_stage_driver.engine.blocks import (
    FLAG_FEEDBACK_HELD,
    FLAG_FEEDFORWARD_HELD,
    FLAG_STOPPED,
    SAMPLES_PER_BLOCK,
    Block,
    BlockCollector,
    Detected,
    Filled,
)
from piezo_stage_driver.engine.feedback_hold import FeedbackHold
from piezo_stage_driver.engine.onboard_feedback import OnboardFeedback
from piezo_stage_driver.engine.program import Phase, Program
from piezo_stage_driver.engine.sources import Source, Volts, held
from piezo_stage_driver.engine.stage_commands import StageCommands
from piezo_stage_driver.engine.ticks import Ramps, Ticks
from piezo_stage_driver.safety.guard_set import FeedbackGuard, GuardSet, SensorGuards
from piezo_stage_driver.safety.guards import StopLatch
from piezo_stage_driver.safety.limits import FeedbackLimits, Limits

LONGEST_STRETCH_SAMPLES = 16000
WAVEFORM_STRETCH_SAMPLES = 200
"""Length for a waveform at the full rate: a quarter of the time that detects a stuck sensor."""


class StageEngine:
    """Play programs of voltages on a backend, tick by tick, within the limits.

    A program is a sequence of phases: approach and play, or track. However it ends, the voltage
    returns to rest by a ramp of bounded rate.

    Parameters
    ----------
    ramp_rate_v_per_s : float
        Rate of every approach and return (V/s).
    max_missed_feedback : int
        Largest number of consecutive missed answers; more stop the stage.
    longest_stretch_samples : int
        Largest number of samples between two checks for commands while a waveform plays.
    sensor_guards : sequence, or dict of str to sequence
        Guards that examine every stretch of samples; see `GuardSet`.
    feedback_guard : FeedbackOscillation, optional, or dict of str to such guards
        Guard that examines every answer before it acts; see `GuardSet`.
    latch : StopLatch, optional
        Latch of a stop, which outlives the engine; any thread may set it, for the next tick.
    samples_per_block : int
        Samples of a block during tracking without answers; at least one tick. A stretch of a
        waveform is no longer.

    Attributes
    ----------
    commands : StageCommands
        Commands of the clients.
    voltage_v : float
        Last voltage given to the backend (V).
    next_sample : int
        Next sample of the clock to be played.
    client : str
        Client of the present program; empty if there is none.
    longest_program_samples : int or None
        Longest program of a backend that plays stored waveforms; None for other backends.
    """

    def __init__(self, backend: StageBackend, limits: Limits,
                 rest_voltage_v: Volts = 0.0, ramp_rate_v_per_s: Volts = 2000.0,
                 samples_per_tick: int = 40,
                 max_missed_feedback: int = 5,
                 longest_stretch_samples: int = LONGEST_STRETCH_SAMPLES,
                 sensor_guards: SensorGuards = (),
                 feedback_guard: FeedbackGuard = None, latch: StopLatch | None = None,
                 feedback_limits: FeedbackLimits | None = None, samples_per_block: int = 1):
        limits.check_rest(rest_voltage_v)
        self._backend = backend
        self._limits = limits
        self.rest_voltage_v = rest_voltage_v
        self._max_missed_feedback = max_missed_feedback
        self._longest_stretch_samples = longest_stretch_samples
        self._guards = GuardSet(sensor_guards, feedback_guard)
        self._latch = latch or StopLatch()
        self._ticks = Ticks(backend.sample_rate_hz, samples_per_tick)
        # A ramp slowed down by the slew limit would end before it is at rest.
        self._ramps = Ramps(np.minimum(ramp_rate_v_per_s, limits.slew_v_per_s), self._ticks)
        self.sample_period_s = self._ticks.sample_period_s
        self.axes: tuple[str, ...] = tuple(getattr(backend, "axes", ()))
        self.voltage_v = rest_voltage_v
        self.next_sample = 0
        self.client = ""
        # Ticks written ahead: their voltages, the flags of their blocks, the voltage of a feedback
        # on board, and their marks.
        lead_ticks = getattr(backend, "lead_samples", 0) // samples_per_tick
        self._ahead = deque[tuple[np.ndarray, int, Volts | None, np.ndarray | None]](
            [(held(rest_voltage_v, samples_per_tick), 0, None, None)] * lead_ticks)
        self.lead_ticks = lead_ticks
        self.longest_program_samples = getattr(backend, "longest_program_samples", None)
        watch_stop = getattr(backend, "watch_stop", None)
        if watch_stop is not None:
            watch_stop(lambda: bool(self._latch.cause))
        self._put_out_marks = getattr(backend, "put_out_marks", None)
        self._read_signals = (
            getattr(backend, "read_signals", None) if getattr(backend, "signals", ()) else None)
        self._feedback: FeedbackHold | OnboardFeedback | None = None
        self._blocks, self._samples_per_block = BlockCollector(), samples_per_block
        self._program = Program()
        self.commands = StageCommands(self, limits, self._ticks, self._ramps, self._latch,
                                      self._guards, feedback_limits)

    @property
    def tick(self) -> int:
        """Return the next tick to be played."""
        return self.next_sample // self._ticks.samples_per_tick

    @property
    def last_sample(self) -> int:
        """Return the sample number at which the last played sample is measured."""
        return self.next_sample + self.lead_ticks * self._ticks.samples_per_tick - 1

    @property
    def idle(self) -> bool:
        """Return whether nothing is being played."""
        return self._program.over

    @property
    def at_rest(self) -> bool:
        """Return whether the amplifier is at rest, including what is written ahead."""
        # A copy, made at once, as the loop's thread continues while another one reads.
        ahead = tuple(self._ahead)
        return self.idle and self.has_returned and all(
            (voltage_v == self.rest_voltage_v).all() for voltage_v, *_ in ahead)

    @property
    def has_returned(self) -> bool:
        """Return whether the last voltage is that of rest, on every axis."""
        return bool(np.all(self.voltage_v == self.rest_voltage_v))

    @property
    def seconds_to_rest(self) -> float:
        """Return the time that a return to rest would take now (s)."""
        samples = self._ramps.samples(self.voltage_v, self.rest_voltage_v)
        return (samples + (self.lead_ticks + 1) * self._ticks.samples_per_tick
                ) * self.sample_period_s

    @property
    def phase_name(self) -> str:
        """Return the name of the phase: approach, play, track, return or rest."""
        return self._program.phase_name

    @property
    def fraction(self) -> float:
        """Return the fraction of the present program that is done (0 to 1)."""
        return self._program.fraction

    @property
    def seconds_left(self) -> float:
        """Return the remaining time of the present program (s); infinite until a stop."""
        return self._program.samples_left * self.sample_period_s

    @property
    def stop_cause(self) -> str:
        """Return why the stage is stopped; empty if it accepts commands."""
        return self._latch.cause

    @property
    def feedback(self) -> FeedbackHold | OnboardFeedback | None:
        """Return the feedback of the present program; None if there is none."""
        return self._feedback

    @property
    def missed_feedback(self) -> int:
        """Return the number of missed answers since tracking began."""
        return self._feedback.missed if self._feedback else 0

    @property
    def awaiting_answer(self) -> bool:
        """Return whether the next tick would miss its answer if it were played now."""
        return (self.phase_name == "track" and self._feedback is not None
                and not self.stop_cause and self._feedback.awaited(self.tick))

    @property
    def tracks_alone(self) -> bool:
        """Return whether the next tick tracks and needs no answer."""
        return (self.phase_name == "track" and not self._latch.cause
                and not isinstance(self._feedback, FeedbackHold))

    # Programs and feedback

    def begin(self, program: Program, client: str = "",
              feedback: FeedbackHold | OnboardFeedback | None = None,
              decimation: int = 1) -> None:
        """Play a program from the next tick on; `decimation` clock samples give a published one."""
        self.client, self._program, self._feedback = client, program, feedback
        self._blocks.decimation = decimation
        self._guards.begin()

    def ramp(self, name: str, end_v: Volts, decimation: int) -> Phase:
        """Return a ramp from the present voltage to another (V)."""
        return self._ramps.phase(
            name, self.voltage_v, end_v, self._blocks.pending_samples, decimation)

    def answer(self, tick: int, voltage_v: float) -> None:
        """Take the feedback that answers the block of ``tick``.

        Raises `FeedbackError` if it is not finite, or for a future block; it then has no effect.
        """
        feedback = self._feedback  # another thread may end it meanwhile
        if feedback is not None:
            feedback.answer(tick, voltage_v, self.tick)

    def fade_over(self, source: Source, samples: int) -> None:
        """Fade the present phase over to another source, from the next tick on."""
        self._program.fade_over(source, samples)

    def return_to_rest(self) -> None:
        """End the present program by a ramp to the rest voltage, unless that is done."""
        if self.phase_name == "return" or self.idle and self.has_returned:
            return
        self._feedback = None
        self._program.hold_at_end = False
        self._program.replace(self.ramp("return", self.rest_voltage_v, self._blocks.decimation))
        self._end_if_over()

    def stop(self, cause: str) -> None:
        """Ramp to rest and refuse every command until ``reset``."""
        self._latch.stop(cause)
        self.return_to_rest()

    # Time

    def advance(self) -> Block | None:
        """Play the next samples, a tick or several of a waveform; return a block if it is full."""
        if self.holds_block:
            return self._block(self._blocks.flush())
        stopped = bool(self.stop_cause)  # read once: any thread may set it meanwhile
        if stopped:
            self.return_to_rest()
        wanted_v, marks, flags = self._next_voltages()
        if self._feedback is not None:
            wanted_v, held_flag, cause = self._with_feedback(self._feedback, wanted_v)
            if cause:
                self.stop(cause)
                stopped = True
                wanted_v, marks, flags = self._next_voltages()
            flags |= held_flag
        feedback = self._feedback
        tick = self.tick
        if marks is not None and self._put_out_marks is not None:
            self._put_out_marks(marks)
        voltage_v, displacement_um, limit_flags = self._exchange(wanted_v)
        signal = None if self._read_signals is None else self._read_signals()
        played_v, flags, feedback_v, marks = self._count_played(
            voltage_v, flags | limit_flags | (FLAG_STOPPED if stopped else 0), marks)
        if feedback is not None:
            feedback.take(tick, played_v, displacement_um)
        ended = self._program.advance(len(voltage_v))
        block = self._collect(played_v, displacement_um, flags, ended is not None, feedback_v,
                              Detected(marks, signal))
        self._go_on_after(ended)
        self._watch(played_v, displacement_um)
        return block

    @property
    def holds_block(self) -> bool:
        """Return whether the pending samples form a block to which no more will be added."""
        return self._blocks.decimation == 1 and self._blocks.pending_samples > 0 and (
            self.phase_name != "track" or bool(self.stop_cause))

    def _with_feedback(self, feedback: FeedbackHold | OnboardFeedback,
                       planned_v: np.ndarray) -> tuple[np.ndarray, int, str]:
        """Add the feedback of the next tick; return its flag, and a reason if it must not act."""
        held = feedback.begin(self.tick)
        wanted_v = planned_v if feedback.each_sample else feedback.add(planned_v)
        cause = feedback.cause or self._guards.examine_feedback(feedback.voltage_v)
        return wanted_v, FLAG_FEEDBACK_HELD if held else 0, cause

    def _next_voltages(self) -> tuple[np.ndarray, np.ndarray | None, int]:
        """Return the next samples of the program, their marks if there are any, and their flags."""
        phase, decimation = self._program.phase(self.voltage_v), self._blocks.decimation
        # Tracking advances tick by tick: answers, laws and streams arrive between two ticks.
        wanted = SAMPLES_PER_BLOCK * decimation
        if decimation == 1:
            wanted = (1 if phase.name in ("rest", "track")
                      else min(self._samples_per_block, WAVEFORM_STRETCH_SAMPLES))
        count = self._ticks.stretch(min(wanted, phase.samples), self._longest_stretch_samples)
        planned_v = phase.source.take(count)
        marks = None if phase.marks is None else phase.marks.take(count)
        held = FLAG_FEEDFORWARD_HELD if phase.source.exhausted else 0
        return planned_v, marks, phase.flag | held

    def _exchange(self, wanted_v: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
        """Play voltages within the limits; return them, the displacement and the limits' flags."""
        feedback = self._feedback
        if isinstance(feedback, OnboardFeedback) and feedback.each_sample:
            return self._exchange_each(wanted_v, feedback)
        voltage_v, flags = self._limits.apply(wanted_v, self.voltage_v, self.sample_period_s)
        if flags and isinstance(feedback, OnboardFeedback):
            feedback.limit(voltage_v - wanted_v)
        return voltage_v, self._backend.exchange(voltage_v), flags

    def _exchange_each(self, planned_v: np.ndarray,
                       feedback: OnboardFeedback) -> tuple[np.ndarray, np.ndarray, int]:
        """Play sample by sample, each with the feedback from the previous one."""
        voltage_v, displacement_um = np.empty((2, len(planned_v)))
        last_v, flags = self.voltage_v, 0
        for sample in range(len(planned_v)):
            part = slice(sample, sample + 1)
            wanted_v = feedback.add(planned_v[part])
            voltage_v[part], flag = self._limits.apply(wanted_v, last_v, self.sample_period_s)
            if flag:
                feedback.limit(voltage_v[part] - wanted_v)
            displacement_um[part] = self._backend.exchange(voltage_v[part])
            feedback.take_sample(displacement_um[part])
            last_v = float(voltage_v[sample])
            flags |= flag
        return voltage_v, displacement_um, flags

    def _count_played(
            self, voltage_v: np.ndarray, flags: int, marks: np.ndarray | None,
    ) -> tuple[np.ndarray, int, Volts | None, np.ndarray | None]:
        """Count samples; return the voltages and so on that were measured with them."""
        last_v = voltage_v[-1]
        self.voltage_v = last_v.copy() if self.axes else float(last_v)
        self.next_sample += len(voltage_v)
        feedback = self._feedback
        self._ahead.append((voltage_v, flags, feedback.voltage_v
                            if isinstance(feedback, OnboardFeedback) else None, marks))
        return self._ahead.popleft()

    def _collect(self, voltage_v: np.ndarray, displacement_um: np.ndarray, flags: int,
                 ends: bool, feedback_v: Volts | None, detected: Detected) -> Block | None:
        """Return the block that these samples complete, if any."""
        answered = isinstance(self._feedback, FeedbackHold) or self.phase_name != "track"
        self._blocks.samples_per_block = 1 if answered else self._samples_per_block
        filled = self._blocks.add(
            voltage_v, displacement_um, flags, ends, feedback_v, detected)
        return None if filled is None else self._block(filled)

    def _block(self, filled: Filled) -> Block:
        next_sample = self.next_sample - self._blocks.pending_samples
        return Block(
            first_sample=next_sample - filled.samples,
            sample_period_s=self._blocks.decimation * self.sample_period_s,
            tick=next_sample // self._ticks.samples_per_tick,
            voltage_v=filled.voltage_v, displacement_um=filled.displacement_um,
            flags=filled.flags, missed_feedback=self.missed_feedback,
            feedback_v=np.array(filled.feedback_v) if filled.feedback_v else None,
            marks=filled.detected.marks, signal=filled.detected.signal)

    def _go_on_after(self, ended: Phase | None) -> None:
        """Return to rest after the last phase, unless its voltage is to be held."""
        if ended is not None and self.idle and ended.name != "return" \
                and not self._program.hold_at_end:
            self.return_to_rest()
        self._end_if_over()

    def _watch(self, voltage_v: np.ndarray, displacement_um: np.ndarray) -> None:
        """Stop if a guard objects, or too many answers are missing."""
        cause = self._guards.examine_samples(
            voltage_v, displacement_um, self._ticks.samples_per_tick)
        missed = self._feedback.missed_in_a_row if self._feedback else 0
        if not cause and missed > self._max_missed_feedback:
            cause = f"{missed} feedback answers in a row were missed"
        if cause and not self.stop_cause:
            self.stop(cause)

    def _end_if_over(self) -> None:
        if self.idle:
            self.client = ""
            self._feedback = None
            self._blocks.decimation = 1
