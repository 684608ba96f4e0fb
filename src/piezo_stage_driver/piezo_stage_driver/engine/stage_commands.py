# SPDX-License-Identifier: BSD-3-Clause
"""The commands of clients to the stage, and the conditions under which they are refused."""

import math
import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from piezo_models.feedback_law.feedback_law import FeedbackLaw
from piezo_stage_driver.engine.blocks import FLAG_PLAYING, FLAG_TRACKING
from piezo_stage_driver.engine.feedback_hold import FeedbackHold
from piezo_stage_driver.engine.onboard_feedback import CheckedLaw, OnboardFeedback
from piezo_stage_driver.engine.program import Phase, Program, StageRefusal
from piezo_stage_driver.engine.sources import Feedforward, Marks, Waveform
from piezo_stage_driver.engine.ticks import Ramps, Ticks
from piezo_stage_driver.safety.guard_set import GuardSet
from piezo_stage_driver.safety.guards import StopLatch
from piezo_stage_driver.safety.limits import FeedbackLimits, Limits, VoltageLimits

if TYPE_CHECKING:
    from piezo_stage_driver.engine.stage_engine import StageEngine

# Ten periods of a mode of 500 Hz: too slow to excite it, and too short for creep to matter.
FADE_S = 0.02


@dataclass(frozen=True, eq=False)
class Replacement:
    """A feedforward, and the law that goes with it, to switch to within a run."""

    feedforward: Feedforward

    law: CheckedLaw | None
    """None without feedback."""


class StageCommands:
    """Turn the commands of clients into programs that the engine plays.

    A command that must not act raises `StageRefusal`, or `LimitError` for its voltages and
    `FeedbackLawError` for its law; nothing changes then.
    """

    def __init__(self, engine: "StageEngine", limits: Limits, ticks: Ticks, ramps: Ramps,
                 latch: StopLatch, guards: GuardSet,
                 feedback_limits: FeedbackLimits | None = None):
        self._engine, self._limits, self._ticks, self._ramps = engine, limits, ticks, ramps
        self._latch, self._guards = latch, guards
        self._feedback_limits = feedback_limits or FeedbackLimits()
        self._feedforward: Feedforward | None = None
        self._feedforward_marks: Feedforward | None = None
        self._feedforward_id = 0
        self._law: CheckedLaw | None = None
        self._begun_s = -math.inf

    def play(self, voltage_v: npt.ArrayLike, sample_period_s: float, repeats: int = 1,
             hold_at_end: bool = False, client: str = "",
             axes: Sequence[str] = (), marks: npt.ArrayLike = ()) -> tuple[int, int]:
        """Begin to play a waveform, after an approach from the present voltage.

        The voltages (V) are (n,), or (n * axes,) with several axes: a value of each axis, sample by
        sample. `axes` are then the names of all axes in the order of the stage. The period of the
        values is a whole multiple of the clock's period, at most 1 s. With `hold_at_end`, the stage
        stays at the last voltage instead of returning to rest. The name of the client is reported
        to others that are refused meanwhile. The marks of the samples, (n,), are for cameras and
        detectors; they are held and repeated like the voltages.

        Return the first sample of the waveform on the sample clock, and its length in samples.
        """
        self._require_ready()
        voltage_v = self._by_sample(np.array(voltage_v, dtype=float), axes)
        marks = _checked_marks(marks, len(voltage_v))
        hold_samples = self._ticks.samples_per_value(sample_period_s)
        if repeats < 1:
            raise StageRefusal("repeats is 0: play the waveform at least once")
        self._limits.check(voltage_v, self._ticks.sample_period_s)
        self._limits.check(voltage_v[:1], self._ticks.sample_period_s,
                           voltage_v[-1] if repeats > 1 else None)
        waveform = Waveform(voltage_v, hold_samples, repeats)
        approach = self._engine.ramp("approach", voltage_v[0], hold_samples)
        length = self._ticks.aligned(waveform.samples, hold_samples)
        self._require_room(approach.samples + length, voltage_v, hold_at_end)
        way_back_samples = 0 if hold_at_end else self._ramps.samples(
            voltage_v[-1], self._engine.rest_voltage_v)
        self._engine.begin(Program(
            [approach, Phase("play", waveform, length, FLAG_PLAYING,
                             Marks(marks, hold_samples, repeats) if marks.any() else None)],
            way_back_samples, hold_at_end), client, decimation=hold_samples)
        return self._engine.last_sample + 1 + int(approach.samples), waveform.samples

    def load_feedforward(self, once_voltage_v: npt.ArrayLike, period_voltage_v: npt.ArrayLike,
                         append: bool = False, feedforward_id: int = 0,
                         axes: Sequence[str] = (), once_marks: npt.ArrayLike = (),
                         period_marks: npt.ArrayLike = ()) -> int:
        """Load the feedforward that ``start_tracking`` plays; return its unique number.

        ``once_voltage_v``, (n,), is played once, and ``period_voltage_v``, (m,), is then repeated,
        at the rate of the sample clock. With several axes they hold a value of each axis, sample by
        sample, and `axes` are the names of all axes in the order of the stage. For the marks of the
        samples, (n,) and (m,), see `play`; a stream has none.

        With `append`, ``once_voltage_v`` is appended to the feedforward with the number
        `feedforward_id`, or with 0 to the loaded one, also while it plays.
        """
        limits = self._limits
        once_voltage_v = self._by_sample(np.array(once_voltage_v, dtype=float), axes)
        if self._engine.longest_program_samples is not None:
            raise StageRefusal("the backend plays stored waveforms only, and cannot be led sample "
                               "by sample: play a waveform instead of tracking")
        if append:
            self._require_not_stopped()
            if self._feedforward is None or self._feedforward.periodic:
                raise StageRefusal("there is no streamed feedforward to append to: "
                                   "load one without a repeated part first")
            self._require_loaded(feedforward_id)
            if np.size(once_marks) or np.size(period_marks):
                raise StageRefusal("a stream carries no marks: load them with a repeated part")
            limits.check(once_voltage_v, self._ticks.sample_period_s, self._feedforward.last_v)
            self._feedforward.append(once_voltage_v)
            return self._feedforward_id
        self._require_ready()
        feedforward = Feedforward(
            once_voltage_v, self._by_sample(np.array(period_voltage_v, dtype=float), axes))
        limits.check(feedforward.sequence_v, self._ticks.sample_period_s)
        marks = _marks_of(feedforward, once_marks, period_marks)
        self._feedforward, self._feedforward_marks, self._law = feedforward, marks, None
        # Random, so that a restarted stage does not reuse its numbers.
        self._feedforward_id = secrets.randbits(63) + 1
        return self._feedforward_id

    def checked(self, law: FeedbackLaw) -> CheckedLaw:
        """Check a feedback law for this stage; callable from any thread, as it exceeds a tick."""
        if law.axes != self._engine.axes:
            raise StageRefusal(f"the feedback law is of {_axes_text(law.axes)}, the stage has "
                               f"{_axes_text(self._engine.axes)}: design it for this stage")
        return CheckedLaw(law, self._ticks.samples_per_tick, self._engine.lead_ticks,
                          self._engine.rest_voltage_v, self._feedback_limits)

    def load_feedback(self, law: CheckedLaw, feedforward_id: int = 0) -> None:
        """Load the law that ``start_tracking`` evaluates together with the loaded feedforward.

        If a law acts at present, the next tick begins with the new one. A number names the
        feedforward that it goes with; 0 is the loaded one.
        """
        self._require_not_stopped()
        self._require_loaded(feedforward_id)
        feedback = self._engine.feedback
        if isinstance(feedback, OnboardFeedback):
            feedback.replace(law)
            return
        self._require_ready()
        if self._feedforward is None:
            raise StageRefusal("no feedforward is loaded that the feedback law could correct: "
                               "call load_feedforward first")
        self._law = law

    def replacement(self, once_voltage_v: npt.ArrayLike, period_voltage_v: npt.ArrayLike,
                    law: FeedbackLaw | None) -> Replacement:
        """Check the input of `replace_feedforward`, from any thread, as that exceeds a tick."""
        limits = self._limits
        if not isinstance(limits, VoltageLimits):
            raise StageRefusal("replace_feedforward takes a stage of one axis, this one has "
                               f"{_axes_text(self._engine.axes)}: load feedforward and law between "
                               "two runs")
        feedforward = Feedforward(np.array(once_voltage_v, dtype=float),
                                  np.array(period_voltage_v, dtype=float))
        limits.check(feedforward.sequence_v, self._ticks.sample_period_s)
        return Replacement(feedforward, None if law is None else self.checked(law))

    def replace_feedforward(self, replacement: Replacement) -> int:
        """Switch to another feedforward and its law between two ticks; return the first tick.

        The law acts from the next tick on, in a state that continues the output of the previous
        law. The planned voltage is faded over within `FADE_S`. If the replacement is refused, the
        present feedforward and law continue.
        """
        self._require_not_stopped()
        engine, present = self._engine, self._feedforward
        following, feedback = replacement.feedforward, engine.feedback
        if present is None or engine.phase_name != "track":
            raise StageRefusal(f"the stage does not track ({engine.phase_name}): "
                               "load the feedforward for the next run")
        if present.streamed or isinstance(feedback, FeedbackHold):
            raise StageRefusal("the feedforward of this run is streamed or its blocks are "
                               "answered: replace it between two runs")
        if present.lengths != following.lengths:
            raise StageRefusal(
                "the feedforward has {} and {} samples where {} and {} play: plan it for the same "
                "reference".format(*following.lengths, *present.lengths))
        if (replacement.law is None) != (feedback is None):
            raise StageRefusal("a law acts in this run and the replacement has none, or the other "
                               "way round: replace both, or neither")
        if isinstance(feedback, OnboardFeedback) and replacement.law is not None:
            feedback.replace(replacement.law)
        following.go_on_from(present)
        engine.fade_over(following, self._ticks.aligned(
            math.ceil(FADE_S / self._ticks.sample_period_s), 1))
        self._feedforward, self._law = following, replacement.law
        return engine.tick

    def start_tracking(self, feedback: bool, ticks: int = 0, client: str = "",
                       onboard: bool = False, feedforward_id: int = 0) -> int:
        """Play the loaded feedforward; return the first tick.

        With `feedback`, the answers to the blocks are added; with `onboard`, the output of the
        loaded law is added instead. The run lasts `ticks`, or with 0 until a stop. `feedforward_id`
        is the number of the feedforward to play; 0 stands for the loaded one.
        """
        self._require_ready()
        if feedback and self._engine.axes:
            raise StageRefusal("nobody answers the blocks of several axes: load a feedback law")
        if self._feedforward is None:
            raise StageRefusal("no feedforward is loaded: call load_feedforward first")
        self._require_loaded(feedforward_id)
        if self._feedforward.forgotten:
            raise StageRefusal("the streamed feedforward has been played: load it again")
        self._limits.check_start(self._feedforward.first_v, self._engine.voltage_v,
                                 self._ramps.v_per_tick)
        beginning = self._engine.tick, self._engine.lead_ticks, self._feedback_limits
        added: FeedbackHold | OnboardFeedback | None = None
        if onboard:
            if self._law is None:
                raise StageRefusal("no feedback law is loaded for this feedforward: "
                                   "call load_feedback first")
            added = OnboardFeedback(self._law, *beginning)
        elif feedback:
            added = FeedbackHold(*beginning)
        self._feedforward.rewind()
        if self._feedforward_marks is not None:
            self._feedforward_marks.rewind()
        samples = ticks * self._ticks.samples_per_tick or math.inf
        self._engine.begin(Program(
            [Phase("track", self._feedforward, samples, FLAG_TRACKING,
                   self._feedforward_marks)]), client, added)
        self._begun_s = time.monotonic()
        return self._engine.tick

    def stop_tracking(self, asked_s: float = math.inf) -> None:
        """End the tracking, unless it began after the request, at a monotonic time in s."""
        if self._engine.phase_name != "track":
            raise StageRefusal(f"the stage does not track ({self._engine.phase_name})")
        if asked_s < self._begun_s:
            raise StageRefusal("the present run began after this was asked for: ask again")
        self._engine.return_to_rest()

    def reset(self, asked_s: float = math.inf) -> None:
        """Accept commands again after a stop; for the time of the request see `StopLatch.reset`.

        Raises `StageRefusal` while the voltage still returns to rest, or if the stage was stopped
        after the request.
        """
        engine = self._engine
        if not engine.idle or engine.stop_cause and not engine.has_returned:
            raise StageRefusal("the stage still returns to rest: reset it afterwards")
        self._latch.reset(asked_s)
        self._guards.begin()

    def _by_sample(self, voltage_v: np.ndarray, axes: Sequence[str]) -> np.ndarray:
        """Return voltages as samples of all axes, shape (n, axes), or (n,) for a single axis."""
        own = self._engine.axes
        if tuple(axes) != own:
            raise StageRefusal(
                f"the voltages are of {_axes_text(axes)}, the stage has {_axes_text(own)}: give a "
                "voltage of each, sample by sample, and their names in this order")
        if not own:
            return voltage_v
        if voltage_v.size % len(own):
            raise StageRefusal(f"the waveform has {voltage_v.size} voltages for {len(own)} axes: "
                               "give as many of each")
        return voltage_v.reshape(-1, len(own))

    def _require_room(self, samples: float, voltage_v: np.ndarray, hold_at_end: bool) -> None:
        """Refuse a waveform that exceeds the memory of a backend with stored waveforms."""
        engine = self._engine
        longest = engine.longest_program_samples
        if longest is None:
            return
        if hold_at_end:
            raise StageRefusal("the backend plays stored waveforms, which end at rest: "
                               "set hold_at_end to false")
        # A return that begins at any moment must fit as well, and one sample at rest.
        farthest_v = engine.rest_voltage_v + np.abs(voltage_v - engine.rest_voltage_v).max(axis=0)
        needed = int(samples + self._ramps.phase(
            "return", farthest_v, engine.rest_voltage_v).samples) + self._ticks.samples_per_tick
        if needed > longest:
            raise StageRefusal(
                f"the waveform takes {needed} samples with its ramps, {longest} are what the "
                "backend plays at once: shorten it, or set the stage's sample_rate_hz lower")
        if not engine.at_rest:
            raise StageRefusal("the backend still plays the waveform before: wait for its end")

    def _require_loaded(self, feedforward_id: int) -> None:
        """Refuse a request for a feedforward that has been replaced by another."""
        if feedforward_id not in (0, self._feedforward_id):
            raise StageRefusal("another feedforward was loaded since: let one client at a time use "
                               "the stage, and load yours again")

    def _require_not_stopped(self) -> None:
        if self._latch.cause:
            raise StageRefusal(f"the stage is stopped ({self._latch.cause}): reset it first")

    def _require_ready(self) -> None:
        self._require_not_stopped()
        engine = self._engine
        if not engine.idle:
            client = f" for {engine.client}" if engine.client else ""
            left_s = engine.seconds_left
            left = f", {left_s:.2g} s left" if math.isfinite(left_s) else ", until it is stopped"
            raise StageRefusal(f"the stage is busy ({engine.phase_name}{client}{left}): "
                               "wait, or cancel that first")


def _checked_marks(marks: npt.ArrayLike, samples: int) -> np.ndarray:
    """Return the marks of some samples, shape (samples,), or none at all."""
    marks = np.array(marks, dtype=np.uint8)
    if len(marks) not in (0, samples):
        raise StageRefusal(f"the waveform has {samples} samples and {len(marks)} marks: "
                           "give a mark for each sample, or none")
    return marks


def _marks_of(feedforward: Feedforward, once_marks: npt.ArrayLike,
              period_marks: npt.ArrayLike) -> Feedforward | None:
    """Return what gives the marks of a feedforward, sample by sample; None if it has none."""
    parts = [_checked_marks(marks, samples) for marks, samples in zip(
        (once_marks, period_marks), feedforward.lengths, strict=True)]
    if not any(part.any() for part in parts):
        return None
    once, period = (part if len(part) else np.zeros(samples, np.uint8)
                    for part, samples in zip(parts, feedforward.lengths, strict=True))
    # Behind a part that is played once there are no marks, where voltages are held.
    return Feedforward(once, period if len(period) else np.zeros(1, np.uint8))


def _axes_text(axes: Sequence[str]) -> str:
    return f"the axes {', '.join(axes)}" if axes else "one axis without a name"
