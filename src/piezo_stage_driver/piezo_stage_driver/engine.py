# SPDX-License-Identifier: BSD-3-Clause
"""The stage, tick by tick: what it plays, what it adds, when it stops."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from piezo_stage_driver.feedback_hold import FeedbackHold
from piezo_stage_driver.sources import Feedforward, Hold, Ramp, Waveform

# Flags of a block beside those of limits.py; the values are those of SampleBlock.
FLAG_FEEDBACK_HELD = 4
FLAG_RAMPING = 8
FLAG_PLAYING = 16
FLAG_TRACKING = 32
FLAG_STOPPED = 64
FLAG_FEEDFORWARD_HELD = 128

SAMPLES_PER_BLOCK = 40
LONGEST_CHUNK_SAMPLES = 16000
LONGEST_SAMPLE_PERIOD_S = 1.0


class StageRefusal(ValueError):
    """A command that the stage cannot take now."""


@dataclass(frozen=True)
class Block:
    """Samples to publish, see ``piezo_interfaces/SampleBlock``."""

    first_sample: int
    sample_period_s: float
    tick: int
    voltage_v: np.ndarray
    displacement_um: np.ndarray
    flags: int
    missed_feedback: int


@dataclass
class Phase:
    """A stretch of samples from one source; ``samples`` is infinite where only a stop ends it."""

    name: str
    source: object
    samples: float
    flag: int


class StageEngine:
    """Drive a backend.

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
    longest_chunk_samples : int
        How far to run between two looks at the commands while no feedback is added.
    """

    def __init__(self, backend, limits, rest_voltage_v=0.0, ramp_rate_v_per_s=2000.0,
                 samples_per_tick=40, max_missed_feedback=5,
                 longest_chunk_samples=LONGEST_CHUNK_SAMPLES):
        limits.check_rest(rest_voltage_v)
        self._backend = backend
        self._limits = limits
        self._rest_voltage_v = rest_voltage_v
        self._ramp_rate_v_per_s = ramp_rate_v_per_s
        self._samples_per_tick = samples_per_tick
        self._max_missed_feedback = max_missed_feedback
        self._longest_chunk_samples = longest_chunk_samples
        self.sample_period_s = 1.0 / backend.sample_rate_hz
        self.voltage_v = rest_voltage_v
        self.next_sample = 0
        self.stop_cause = ""
        self._feedforward = None
        self._feedback = None
        self._end_program()
        self._clear_pending()

    @property
    def tick(self):
        """The tick about to be played."""
        return self.next_sample // self._samples_per_tick

    @property
    def idle(self):
        """Whether nothing is being played."""
        return not self._phases

    @property
    def phase_name(self):
        """Approach, play, track, return or rest."""
        return self._phases[0].name if self._phases else "rest"

    @property
    def fraction(self):
        """Done of the present program, 0 to 1."""
        return min(1.0, self._done_samples / self._program_samples)

    @property
    def seconds_left(self):
        """Stage time left of the present program (s); infinite until a stop."""
        return max(0.0, self._program_samples - self._done_samples) * self.sample_period_s

    @property
    def missed_feedback(self):
        """Answers missed since tracking began."""
        return self._feedback.missed if self._feedback else 0

    @property
    def awaiting_answer(self):
        """Whether the next tick would miss its answer if it were played now."""
        return (self.phase_name == "track" and self._feedback is not None
                and self._feedback.awaited(self.tick))

    # Commands

    def play(self, voltage_v, sample_period_s, repeats=1, hold_at_end=False):
        """Play a waveform.

        Parameters
        ----------
        voltage_v : ndarray, shape (n,)
        sample_period_s : float
            Whole multiple of the clock's period, at most 1 s.
        repeats : int
        hold_at_end : bool
            Stay at the last voltage instead of returning to rest.

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
        hold_samples = self._hold_samples(sample_period_s)
        if repeats < 1:
            raise StageRefusal("repeats is 0: play the waveform at least once")
        self._limits.check(voltage_v, self.sample_period_s)
        self._limits.check(voltage_v[:1], self.sample_period_s,
                           voltage_v[-1] if repeats > 1 else None)
        self._decimation = hold_samples
        waveform = Waveform(voltage_v, hold_samples, repeats)
        approach = self._ramp("approach", self.voltage_v, voltage_v[0])
        phases = [approach, Phase("play", waveform, self._aligned(waveform.samples), FLAG_PLAYING)]
        self._begin_program(phases, voltage_v[-1], hold_at_end)
        return self.next_sample + approach.samples, waveform.samples

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
            if self._feedforward is None or self._feedforward.periodic:
                raise StageRefusal("there is no streamed feedforward to append to: "
                                   "load one without a repeated part first")
            self._limits.check(once_voltage_v, self.sample_period_s,
                               self._feedforward.sequence_v[-1])
            self._feedforward.append(once_voltage_v)
            return
        self._require_ready()
        feedforward = Feedforward(once_voltage_v, np.array(period_voltage_v, dtype=float))
        self._limits.check(feedforward.sequence_v, self.sample_period_s)
        self._feedforward = feedforward

    def start_tracking(self, feedback, ticks=0):
        """Play the loaded feedforward.

        Parameters
        ----------
        feedback : bool
            Add the answers to the blocks.
        ticks : int
            How long; 0 until a stop.

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
        self._limits.check(self._feedforward.sequence_v[:1], self.sample_period_s, self.voltage_v)
        self._feedforward.rewind()
        self._feedback = FeedbackHold(self.tick) if feedback else None
        samples = ticks * self._samples_per_tick or math.inf
        phases = [Phase("track", self._feedforward, samples, FLAG_TRACKING)]
        self._begin_program(phases, self._rest_voltage_v, hold_at_end=False)
        return self.tick

    def answer(self, tick, voltage_v):
        """Take the feedback that answers the block of ``tick``.

        Raises
        ------
        FeedbackError
            If it is not a finite number; it then counts as missed.
        """
        feedback = self._feedback  # which another thread may end meanwhile
        if feedback is not None:
            feedback.answer(tick, voltage_v)

    def stop_tracking(self):
        """End the tracking.

        Raises
        ------
        StageRefusal
            If the stage does not track.
        """
        if self.phase_name != "track":
            raise StageRefusal(f"the stage does not track ({self.phase_name})")
        self.return_to_rest()

    def return_to_rest(self):
        """End the present program by a ramp to the rest voltage."""
        self._phases.clear()
        self._begin_return()

    def emergency_stop(self, cause):
        """Ramp to rest and refuse every command until ``reset``."""
        self.stop_cause = self.stop_cause or cause
        self.return_to_rest()

    def reset(self):
        """Take commands again after a stop.

        Raises
        ------
        StageRefusal
            While the voltage still returns to rest.
        """
        if not self.idle:
            raise StageRefusal("the stage still returns to rest: reset it afterwards")
        self.stop_cause = ""

    # Time

    def advance(self):
        """Play the next samples.

        Returns
        -------
        block : Block or None
            None while a slow waveform has not filled a block.
        """
        phase = self._phases[0] if self._phases else Phase(
            "rest", Hold(self.voltage_v), math.inf, 0)
        count = self._chunk_samples(phase)
        flags = phase.flag | (FLAG_STOPPED if self.stop_cause else 0)
        wanted_v = phase.source.take(count)
        if phase.name == "track":
            flags |= FLAG_FEEDFORWARD_HELD if phase.source.exhausted else 0
            if self._feedback is not None:
                flags |= FLAG_FEEDBACK_HELD if self._feedback.begin(self.tick) else 0
                wanted_v = wanted_v + self._feedback.voltage_v
        voltage_v, limited = self._limits.apply(wanted_v, self.voltage_v, self.sample_period_s)
        displacement_um = self._backend.exchange(voltage_v)
        self.voltage_v = float(voltage_v[-1])
        self.next_sample += count
        self._done_samples += count
        phase.samples -= count
        block = self._collect(voltage_v, displacement_um, flags | limited, phase.samples <= 0)
        if phase.samples <= 0:
            self._end_phase()
        if self._feedback and self._feedback.missed_in_a_row > self._max_missed_feedback \
                and self.phase_name == "track":
            self.emergency_stop(f"{self._feedback.missed_in_a_row} feedback answers in a row "
                                "were missed")
        return block

    # Phases

    def _require_ready(self):
        if self.stop_cause:
            raise StageRefusal(f"the stage is stopped ({self.stop_cause}): reset it first")
        if not self.idle:
            raise StageRefusal(f"the stage is busy ({self.phase_name}): wait, or cancel that first")

    def _begin_program(self, phases, last_voltage_v, hold_at_end):
        self._hold_at_end = hold_at_end
        self._phases = deque(phase for phase in phases if phase.samples > 0)
        way_back = 0 if hold_at_end else self._ramp_samples(last_voltage_v, self._rest_voltage_v)
        self._program_samples = sum(phase.samples for phase in phases) + way_back
        self._done_samples = 0

    def _end_phase(self):
        ended = self._phases.popleft()
        if self._phases:
            return
        if ended.name == "return" or self._hold_at_end:
            self._end_program()
        else:
            self._begin_return()

    def _begin_return(self):
        self._feedback = None
        way_back = self._ramp("return", self.voltage_v, self._rest_voltage_v)
        if way_back.samples > 0:
            self._phases = deque([way_back])
            self._program_samples = self._done_samples + way_back.samples
        else:
            self._end_program()

    def _end_program(self):
        self._phases = deque()
        self._decimation = 1
        self._program_samples = self._done_samples = 1

    def _ramp_samples(self, start_v, end_v):
        return math.ceil(abs(end_v - start_v) / self._ramp_rate_v_per_s / self.sample_period_s)

    def _ramp(self, name, start_v, end_v):
        # What an interrupted program left half collected is completed by at least one sample.
        samples = max(self._ramp_samples(start_v, end_v), self._pending_samples > 0)
        length = self._aligned(samples + self._pending_samples) - self._pending_samples
        return Phase(name, Ramp(start_v, end_v, samples), length, FLAG_RAMPING)

    def _hold_samples(self, sample_period_s):
        if not (math.isfinite(sample_period_s)
                and self.sample_period_s <= sample_period_s * (1 + 1e-9)
                and sample_period_s <= LONGEST_SAMPLE_PERIOD_S):
            raise StageRefusal(
                f"the sample period {sample_period_s:g} s is not within "
                f"[{self.sample_period_s:g}, {LONGEST_SAMPLE_PERIOD_S:g}] s")
        ratio = sample_period_s / self.sample_period_s
        if abs(ratio - round(ratio)) > 1e-6 * ratio:
            raise StageRefusal(
                f"the sample period {sample_period_s:g} s is no whole multiple of the "
                f"clock period {self.sample_period_s:g} s")
        return round(ratio)

    def _aligned(self, samples):
        """Return the length rounded up to whole ticks and whole published samples."""
        unit = math.lcm(self._samples_per_tick, self._decimation)
        return math.ceil(samples / unit) * unit

    def _chunk_samples(self, phase):
        if self._decimation == 1:
            return self._samples_per_tick
        ticks = SAMPLES_PER_BLOCK * self._decimation // self._samples_per_tick
        longest = max(1, self._longest_chunk_samples // self._samples_per_tick)
        return int(min(max(1, min(ticks, longest)) * self._samples_per_tick, phase.samples))

    # Blocks

    def _clear_pending(self):
        self._pending_voltage_v, self._pending_displacement_um = [], []
        self._pending_samples = self._pending_flags = 0

    def _collect(self, voltage_v, displacement_um, flags, phase_ends):
        self._pending_voltage_v.append(voltage_v)
        self._pending_displacement_um.append(displacement_um)
        self._pending_samples += len(voltage_v)
        self._pending_flags |= flags
        full = self._pending_samples >= SAMPLES_PER_BLOCK * self._decimation
        if not (full or phase_ends) or self._pending_samples % self._decimation:
            return None
        block = Block(
            first_sample=self.next_sample - self._pending_samples,
            sample_period_s=self._decimation * self.sample_period_s,
            tick=self.tick,
            voltage_v=self._decimated(self._pending_voltage_v),
            displacement_um=self._decimated(self._pending_displacement_um),
            flags=self._pending_flags,
            missed_feedback=self.missed_feedback)
        self._clear_pending()
        return block

    def _decimated(self, chunks):
        samples = chunks[0] if len(chunks) == 1 else np.concatenate(chunks)
        if self._decimation == 1:
            return samples
        return samples.reshape(-1, self._decimation).mean(axis=1)
