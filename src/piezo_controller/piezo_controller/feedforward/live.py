# SPDX-License-Identifier: BSD-3-Clause
"""Voltage for a reference that is published during the run, computed as soon as it is known."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from piezo_common.arrays import FloatArray, IntArray
from piezo_controller.feedforward.approach import USUAL_STAGE, StageClock, check_amplifier_range
from piezo_controller.feedforward.feasibility import Infeasible, UnreachableReference
from piezo_controller.feedforward.plan import TrackingPlan
from piezo_controller.feedforward.preview_inverse import short_preview_inverse
from piezo_controller.feedforward.streamed import StreamPlanner, approach_samples, check_voltages
from piezo_controller.references.bounded_motion import SLACK, BoundedMotion
from piezo_controller.references.kind import InvalidReference
from piezo_controller.references.live_reference import LiveReference
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel

DELAY_SAMPLES = 800
"""Samples loaded ahead of the stage: at 40 kHz the 20 ms that messages may take at worst."""

HOLD_BELOW_SAMPLES = 400
"""With fewer samples ahead, the last value is held. A stage in lockstep waits with still fewer."""

HELD_AT_ONCE_SAMPLES = 40
RANGE_MARGIN = 0.02
"""Part of the travel that is reserved at both ends for the dynamics and for creep."""


class DeclaredRange:
    """The range of values that a publisher may give: a peak-to-peak amplitude about a centre (um).

    With a centre of 0, it is determined from the values; `about_centre_um` is then infinite.
    """

    def __init__(self, centre_um: float, amplitude_um: float) -> None:
        self._declared = f"{amplitude_um:g} um" + (f" about {centre_um:g} um" if centre_um else "")
        self._span_um = SLACK * amplitude_um
        half_um = self._span_um / 2.0 if centre_um else math.inf
        self.about_centre_um = centre_um - half_um, centre_um + half_um
        self._lowest_um, self._highest_um = self.about_centre_um

    def check(self, values_um: FloatArray) -> None:
        """Raise `InvalidReference` if these values, or these and earlier ones, exceed the range."""
        if not values_um.size:
            return
        lowest_um, highest_um = float(values_um.min()), float(values_um.max())
        self._lowest_um = max(self._lowest_um, highest_um - self._span_um)
        self._highest_um = min(self._highest_um, lowest_um + self._span_um)
        if not (lowest_um >= self._lowest_um and highest_um <= self._highest_um):
            raise InvalidReference(
                f"the published reference went from {lowest_um:.4g} to {highest_um:.4g} um, beyond "
                f"its declared {self._declared}: publish less, or declare a larger amplitude_um")


class LivePlan(TrackingPlan):
    """Follow published values, of which one has come, with a constant delay.

    If no value comes in time, the last one is held. Speed, acceleration and range are bounded by
    band and amplitude, and there is no jump at the beginning: see `BoundedMotion`. The values have
    a centre, see `DeclaredRange`. Counted are the samples that were held, and that were clipped to
    the reachable range, and how often values were skipped because the publisher was faster than the
    stage.

    Raises `Infeasible` if the amplifier does not reach the first value, and `InvalidReference` if
    that is not within the declared range.
    """

    streamed, period_voltage_v = True, np.empty(0)

    def __init__(self, planner: StreamPlanner, live: LiveReference, band_hz: float,
                 amplitude_um: float, run_samples: int, centre_um: float = 0.0) -> None:
        self._live, self._amplitude_um = live, amplitude_um
        self._declared = DeclaredRange(centre_um, amplitude_um)
        self._centred = bool(centre_um)
        if self._centred:
            self._declared.check(np.array([live.latest_um]))
        self._hysteresis, self._stage = planner.hysteresis, planner.stage
        self._hysteresis_range_um = _within(planner.hysteresis, planner.stage.voltage_range_v[1])
        margin_um = RANGE_MARGIN * (self._hysteresis_range_um[1] - self._hysteresis_range_um[0])
        self.range_um = (self._hysteresis_range_um[0] + margin_um,
                         self._hysteresis_range_um[1] - margin_um)
        self._value_um = float(np.clip(live.latest_um, *self.range_um))
        self.once_voltage_v, once_um, level_um, self._inverse = planner.begin(self._value_um)
        self._motion = BoundedMotion(
            level_um, self._value_um, band_hz, amplitude_um, planner.sample_period_s,
            self._declared.about_centre_um)
        self._last_v = self.once_voltage_v[-1:]
        self.feedback_start_sample = len(self.once_voltage_v)
        self.begin_sample = self.feedback_start_sample + approach_samples(planner.sample_period_s)
        self._total = self.begin_sample + run_samples
        self._known = _Recent(once_um)
        self._loaded = self.once_voltage_v.size
        self._played = self.held_samples = self.clipped_samples = self.skipped = 0
        self.uncompensated = planner.uncompensated
        if planner.margin:
            self._inverse.look_ahead(self._move(np.full(planner.margin, self._value_um)))
        self._following, self._beyond = False, ""
        self._of_first_moments = self._departures
        self._compile()

    @property
    def delay_samples(self) -> int:
        """Return the delay from publishing a value to reaching it, without the time of messages."""
        return self._ahead_samples + self._inverse.preview.preview_samples - \
            self._live.preview_samples

    @property
    def _ahead_samples(self) -> int:
        # Room for two messages: one waits while the other is played.
        return DELAY_SAMPLES + 2 * self._live.longest_samples

    @property
    def note(self) -> str:
        """Return a note on the delay and the first moments of the run; see `degraded`."""
        delay_ms = 1e3 * self.delay_samples * self._stage.sample_period_s
        first = self._described(self._of_first_moments)
        return f"followed the reference {delay_ms:.3g} ms after it was published" + (
            f", in its first moments {first}" if first else "")

    @property
    def degraded(self) -> str:
        """Return how the run departed from the published values after its first moments."""
        departed = self._described(self._departures - self._of_first_moments)
        return "; ".join(filter(None, (self._beyond, departed)))

    @property
    def _departures(self) -> IntArray:
        """Return the counts that `_described` describes."""
        return np.array([self.held_samples, self.clipped_samples, self._motion.far_samples,
                         self._live.bridged_samples, self.skipped])

    def _described(self, departures: IntArray) -> str:
        *samples, skipped = departures
        texts = ("held, as nothing was published",
                 "clipped to {:.4g} to {:.4g} um".format(*self.range_um),
                 "faster than the declared band and amplitude",
                 "a straight line, as values were skipped")
        period_ms = 1e3 * self._stage.sample_period_s
        remarks = [f"for {period_ms * count:.3g} ms it was {text}"
                   for count, text in zip(samples, texts, strict=True) if count]
        if skipped:
            remarks.append(f"values were skipped {skipped} times, as more were published than "
                           "the stage plays")
        return ", ".join(remarks)

    def expected_um(self, first_sample: int, count: int) -> FloatArray:
        """Return the displacements to expect of samples that are loaded (um)."""
        return self._known.sample(first_sample, count)

    def travel_um(self, samples: int) -> float:
        """Return the declared amplitude (um)."""
        return self._amplitude_um

    def take(self, displacement_um: FloatArray) -> None:
        """Count what was played."""
        self._played += len(displacement_um)

    def continuation(self) -> Callable[[], FloatArray | None]:
        """Return a function that gives the next voltages; None until they are due and known."""
        return self._next_voltages

    def _compile(self) -> None:
        """Compile all functions before the stage moves."""
        trial = self._inverse.copy()
        trial.before_linear(np.full(1, self._value_um))
        self._hysteresis.invert(np.full(1, self._value_um), trial.hysteresis)
        self._motion.follow(np.empty(0))

    def _next_voltages(self) -> FloatArray | None:
        ahead, remaining = self._loaded - self._played, self._total - self._loaded
        if remaining <= 0:
            return np.empty(0)
        due = min(remaining, self._ahead_samples - ahead)
        if due <= 0:
            return None
        values_um = self._values(due, must=ahead < HOLD_BELOW_SAMPLES)
        if not values_um.size:
            return None
        try:
            voltage_v = self._voltages(values_um)
        except Infeasible as reason:
            raise UnreachableReference(
                f"the amplifier cannot follow the published reference: {reason}; declare less "
                "frequency_hz or amplitude_um", math.nan) from None
        self._loaded += voltage_v.size
        if self._loaded <= self.begin_sample:
            self._of_first_moments = self._departures
        return voltage_v

    def _values(self, due: int, must: bool) -> FloatArray:
        """Return the next values to follow; the last one is repeated if some are needed."""
        if not self._following:
            # Values that came during the approach are obsolete.
            self._live.keep_newest(due)
            self._following = True
        values_um = self._live.give(due)
        if self._centred or self._loaded >= self.begin_sample:
            try:
                self._declared.check(values_um)
            except InvalidReference as error:
                self._beyond = str(error)
                raise
        if values_um.size == due and self._live.waiting_samples > self._ahead_samples:
            self._live.keep_newest(self._live.longest_samples)
            self.skipped += 1
        if not values_um.size and must and self._live.silent:
            # A late publisher is waited for tick by tick; each tick costs one call of the stage.
            most = due if self._live.patience_s else HELD_AT_ONCE_SAMPLES
            values_um = np.full(min(due, most), self._value_um)
            self.held_samples += values_um.size
        return values_um

    def _voltages(self, values_um: FloatArray) -> FloatArray:
        """Return the voltages for the next values, shifted by the margin of the inverse."""
        hysteresis_um = self._inverse.before_linear(self._move(values_um))
        voltage_v = self._hysteresis.invert(
            np.clip(hysteresis_um, *self._hysteresis_range_um), self._inverse.hysteresis)
        check_voltages(self._last_v, voltage_v, self._hysteresis, self._stage)
        self._last_v = voltage_v[-1:]
        return voltage_v

    def _move(self, values_um: FloatArray) -> FloatArray:
        """Store and return the displacements to expect for the next values."""
        within_um = np.clip(values_um, *self.range_um)
        self.clipped_samples += int(np.count_nonzero(within_um != values_um))
        self._value_um = float(within_um[-1]) if within_um.size else self._value_um
        moved_um = self._motion.follow(within_um)
        self._known.append(moved_um)
        return moved_um


class _Recent:
    """A sequence of displacements that drops those that have been read."""

    def __init__(self, displacement_um: FloatArray) -> None:
        self._first, self._pieces = 0, [displacement_um]

    def append(self, displacement_um: FloatArray) -> None:
        self._pieces.append(displacement_um)

    def sample(self, first: int, count: int) -> FloatArray:
        while self._first + self._pieces[0].size <= first:
            self._first += self._pieces.pop(0).size
        at, pieces, missing = first - self._first, [], count
        for piece in list(self._pieces):
            if missing <= 0:
                break
            pieces.append(piece[at:at + missing])
            missing -= pieces[-1].size
            at = 0
        return np.concatenate(pieces)


def plan_live(live: LiveReference, band_hz: float, amplitude_um: float, run_samples: int,
              model: StageModel, *, centre_um: float = 0.0,
              stage: StageClock = USUAL_STAGE) -> LivePlan:
    """Plan to follow a published reference; see `LivePlan`.

    Raises `UnreachableReference` if the amplifier does not reach the first value, and ValueError if
    the model's range does not fit the amplifier's, or the preview is too short for the band.
    """
    check_amplifier_range(model.hysteresis, stage)
    planner = StreamPlanner(
        model, partial(short_preview_inverse, preview_samples=live.preview_samples,
                       band_hz=band_hz), stage, lambda fraction: None)
    try:
        return LivePlan(planner, live, band_hz, amplitude_um, run_samples, centre_um)
    except Infeasible as reason:
        raise UnreachableReference(
            f"the amplifier cannot go to the published {live.latest_um:.4g} um: {reason}",
            math.nan) from None


def _within(hysteresis: PreisachModel, highest_v: float) -> tuple[float, float]:
    """Return the range of outputs (um) that the amplifier reaches whatever the past."""
    return hysteresis.output_range_um[0], float(hysteresis.simulate([highest_v])[-1])
