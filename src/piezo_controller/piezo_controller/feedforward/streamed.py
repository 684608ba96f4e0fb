# SPDX-License-Identifier: BSD-3-Clause
"""Voltage for a general reference, computed chunk by chunk while the stage plays."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import control
import numpy as np
from scipy.signal import welch

from piezo_common.arrays import FloatArray
from piezo_controller.feedforward.approach import (
    ALIGNMENT_SAMPLES,
    FADE_S,
    RAMP_S,
    USUAL_STAGE,
    StageClock,
    aligned_samples,
    check_amplifier_range,
)
from piezo_controller.feedforward.feasibility import (
    DISPLACEMENT,
    VOLTAGE,
    Infeasible,
    UnreachableReference,
    check_range,
    check_slew,
    unreachable,
)
from piezo_controller.feedforward.online_inverse import (
    EFFECT_MARGIN_SAMPLES,
    OnlineInverse,
    compensated_effects,
)
from piezo_controller.feedforward.periodic import NEGLIGIBLE_PART
from piezo_controller.feedforward.plan import TrackingPlan
from piezo_controller.feedforward.preview_inverse import (
    PREVIEW_SAMPLES,
    PreviewInverse,
    preview_inverse,
)
from piezo_controller.references.kind import Watch
from piezo_controller.references.smooth_rise import minimum_jerk, smooth_rise
from piezo_controller.references.trajectory import KeptTrajectory, Trajectory
from piezo_models.cascade import StageModel
from piezo_models.effects.amplifier_lag import lag_behind_hysteresis
from piezo_models.hysteresis.preisach import PreisachMemory, PreisachModel
from piezo_models.linear.connections import inverse
from piezo_models.linear.dynamics import continue_linear, equilibrium_state, zoh, zoh_response

REST_S = 0.02
APPROACH_S = 0.15
CHUNK_SAMPLES = 4000
# As long as the longest period, so that fast periodic references are checked completely.
CHECKED_S = 20.0
BAND_CHECK_SAMPLES, BAND_CHECKS = 8192, 4

InverseDesign = Callable[[control.StateSpace, float], PreviewInverse]
"""Designs the inverse of fast dynamics for a sample period (s)."""


@dataclass(frozen=True, eq=False)
class StreamPlan(TrackingPlan):
    """Voltages of the approach, and the source of those of the reference."""

    once_voltage_v: FloatArray
    """Down to the model's lowest voltage, which erases the memory of the hysteresis, and up to the
    first value of the reference, (n,)."""
    expected: Trajectory
    """Displacement to expect, from the run's first sample on."""
    reference: Trajectory

    samples: int
    """Number of samples of the reference that are played."""
    begin_sample: int
    """Sample at which the approach ends and the reference begins."""
    uncompensated: tuple[str, ...]
    """Effects of the model that are not compensated."""
    inverse: OnlineInverse
    """State of the inverse after `once_voltage_v`."""
    stage: StageClock

    margin_samples: int
    """Samples of the reference that the inverse needs in advance."""
    feedback_start_sample: int = field(init=False)

    streamed, period_voltage_v = True, np.empty(0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "feedback_start_sample", len(self.once_voltage_v))

    def expected_um(self, first_sample: int, count: int) -> FloatArray:
        """Return the displacements to expect of `count` samples from `first_sample` on (um)."""
        return self.expected.sample(first_sample, count)

    def travel_um(self, samples: int) -> float:
        """Return the peak-to-peak displacement of the first samples of the reference (um).

        It is estimated by a survey if the reference is long.
        """
        return float(np.ptp(self.reference.survey(samples)))

    def continuation(self) -> Callable[[], FloatArray]:
        """Return a function that gives the next of `chunks`, and at the end an empty array."""
        return partial(next, self.chunks(), np.empty(0))

    def chunks(self, chunk_samples: int = CHUNK_SAMPLES) -> Iterator[FloatArray]:
        """Yield the voltages after `once_voltage_v`, chunk by chunk.

        A chunk depends only on the reference up to its end and the preview; computing time and
        memory do not grow with the length of the stream. Raises `UnreachableReference` if a chunk
        would leave the range or exceed the slew limit; the message gives its time.
        """
        computed = self.feedback_start_sample
        try:
            for voltage_v in self._chunks(self.begin_sample + self.samples, chunk_samples):
                yield voltage_v
                computed += voltage_v.size
        except Infeasible as reason:
            begin_s, end_s = (self.stage.sample_period_s * max(at - self.begin_sample, 0)
                              for at in (computed, computed + chunk_samples))
            raise UnreachableReference(
                f"the amplifier cannot follow the reference between {begin_s:.4g} and {end_s:.4g} "
                f"s after its beginning: {reason}; the run ends before: ask for less there",
                math.nan) from None

    def check(self, end: int, watch: Watch) -> None:
        """Compute the voltages up to a sample; raise `Infeasible` if one exceeds the limits."""
        start = computed = self.feedback_start_sample
        for voltage_v in self._chunks(end, CHUNK_SAMPLES):
            computed += voltage_v.size
            watch((computed - start) / (end - start))

    def _chunks(self, end: int, chunk_samples: int) -> Iterator[FloatArray]:
        """Yield the voltages up to a sample, and check each chunk against the limits."""
        start, margin = self.feedback_start_sample, self.margin_samples
        inverse, last_v = self.inverse.copy(), self.once_voltage_v[-1:]
        inverse.look_ahead(self.expected_um(start, margin))
        for first in range(start, end, chunk_samples):
            count = min(chunk_samples, end - first)
            voltage_v = inverse.continue_with(self.expected_um(first + margin, count))
            check_voltages(last_v, voltage_v, self.inverse.model.hysteresis, self.stage)
            last_v = voltage_v[-1:]
            yield voltage_v


def check_voltages(last_v: FloatArray, voltage_v: FloatArray, hysteresis: PreisachModel,
                   stage: StageClock) -> None:
    """Raise `Infeasible` if voltages, after those played last, exceed the limits of a stream."""
    check_range(voltage_v, hysteresis.voltage_min_v, stage.voltage_range_v[1], VOLTAGE)
    check_slew(np.r_[last_v, voltage_v], stage.sample_period_s, stage.slew_limit_v_per_s)


def plan_stream(reference: Trajectory, samples: int, model: StageModel,
                method: str = "least_squares", *, stage: StageClock = USUAL_STAGE,
                preview_samples: int = PREVIEW_SAMPLES,
                watch: Watch | None = None) -> StreamPlan:
    """Plan the voltage that makes a model at rest follow any reference, with a short preview.

    The reference is faded in from `approach_samples` before its beginning, and inverted by a method
    of `preview_inverse`. The first `CHECKED_S` are computed in advance to check the limits, and the
    extremes of the whole reference are checked. The remainder is checked chunk by chunk.

    Raises `UnreachableReference`, which names what is reachable, if the voltage would leave the
    range or exceed the slew limit, and ValueError if the model's range does not fit the
    amplifier's, or the method does not suit the model.
    """
    check_amplifier_range(model.hysteresis, stage)
    planner = StreamPlanner(
        model, partial(preview_inverse, method=method, preview_samples=preview_samples), stage,
        watch or (lambda fraction: None))
    try:
        return planner.plan(reference, samples)
    except Infeasible as reason:
        refused = reason
    raise planner.refusal(reference, samples, refused)


def approach_samples(sample_period_s: float = 25e-6) -> int:
    """Return the number of samples before a reference's beginning that `plan_stream` uses."""
    return aligned_samples(APPROACH_S, sample_period_s)


class StreamPlanner:
    """Plans general references for one model; see `plan_stream`."""

    def __init__(self, model: StageModel, inverse_of: InverseDesign, stage: StageClock,
                 watch: Watch) -> None:
        # A stream compensates the effects after the hysteresis.
        model = replace(model, effects=lag_behind_hysteresis(model.effects))
        self.model = model
        self.hysteresis = model.hysteresis
        self.stage = stage
        self.sample_period_s = stage.sample_period_s
        self.watch = watch
        self.fast = model.dynamics.state_space(model.effects_at("modes"))
        self.preview = inverse_of(self.fast, self.sample_period_s)
        self.slow = model.creep.state_space()
        for effect in model.effects_at("linear"):
            self.slow = effect.state_space() * self.slow
        self.sampled_slow = zoh(self.slow, self.sample_period_s)
        compensated = compensated_effects(model)
        self.margin = self.preview.preview_samples + (EFFECT_MARGIN_SAMPLES if compensated else 0)
        self.uncompensated = tuple(
            effect.name for effect in model.effects
            if effect not in compensated and effect.place not in ("modes", "linear"))

    def plan(self, reference: Trajectory, samples: int) -> StreamPlan:
        """Plan one reference; raise `Infeasible` if that is impossible."""
        approach = approach_samples(self.sample_period_s)
        once_v, slow_um, level_um, inverse = self.begin(reference.sample(-approach, 1)[0])
        expected = _FadedIn(slow_um, level_um, reference, approach,
                            aligned_samples(FADE_S, self.sample_period_s))
        plan = StreamPlan(once_v, KeptTrajectory(expected), reference, samples,
                          once_v.size + approach, self.uncompensated, inverse, self.stage,
                          self.margin)
        self._check_extremes(reference.survey(samples))
        checked = round(CHECKED_S / self.sample_period_s)
        plan.check(plan.begin_sample + min(samples, checked), self.watch)
        self._check_band(reference, samples)
        return plan

    def begin(self, first_um: float) -> tuple[FloatArray, FloatArray, float, OnlineInverse]:
        """Plan the approach to the first displacement; raise `Infeasible` if that is impossible.

        Returns its voltages, the displacements of the slow part during it, the displacement that
        the sensor then measures, and the inverse that continues from there.
        """
        once_v, memory, slow_um, slow_state = self._approach(first_um)
        rest_um = slow_um[-1]
        level_um = self.model.sensed(np.full(ALIGNMENT_SAMPLES, rest_um), self.sample_period_s)[-1]
        return once_v, slow_um, level_um, OnlineInverse(
            self.model, self.preview, inverse(self.sampled_slow), self.sample_period_s,
            self.preview.state(rest_um), slow_state, memory,
            np.full(2 * EFFECT_MARGIN_SAMPLES, level_um))

    def refusal(self, reference: Trajectory, samples: int,
                reason: Infeasible) -> UnreachableReference:
        """Return the error for an infeasible reference."""
        checked = min(samples, round(CHECKED_S / self.sample_period_s))

        def scaled(centre_um: float, scale: float) -> StreamPlan:
            return self.plan(_Scaled(reference, centre_um, scale), samples)

        return unreachable(
            scaled, reference.survey(checked), self.hysteresis.output_range_um, reason)

    def _check_extremes(self, reference_um: FloatArray) -> None:
        """Raise if displacements are out of reach for any past of hysteresis and creep."""
        if compensated_effects(self.model):
            return
        gains = np.array([1.0, float(np.real(self.slow(0.0)))])
        reached_um = np.outer(gains, self.hysteresis.output_range_um)
        check_range(reference_um, reached_um.min(), reached_um.max(), DISPLACEMENT)

    def _check_band(self, reference: Trajectory, samples: int) -> None:
        """Raise if the inverse of the dynamics has too large an error for a reference."""
        count = min(samples, BAND_CHECK_SAMPLES)
        reference_um = np.array([reference.sample(int(first), count)
                                 for first in np.linspace(0, samples - count, BAND_CHECKS)])
        frequency_hz, powers_um2 = welch(reference_um, 1 / self.sample_period_s, nperseg=count)
        power_um2 = powers_um2.mean(axis=0)
        residual = np.abs(1.0 - self.preview.response(frequency_hz, self.sample_period_s)
                          * zoh_response(self.fast, frequency_hz, self.sample_period_s))
        residual_um = math.sqrt((residual**2 * power_um2).sum() * frequency_hz[1])
        travel_um = np.ptp(reference_um)
        # Rounding errors do not count, as for a constant reference.
        if residual_um > max(NEGLIGIBLE_PART * travel_um, 1e-9 * np.abs(reference_um).max()):
            raise UnreachableReference(
                f"the inverse with {self.preview.preview_samples} samples of preview leaves an "
                f"error of {100 * residual_um / travel_um:.2g} % of this reference, as it moves "
                "too fast for it: omit what is above 2 kHz, or choose another inversion", math.nan)

    def _approach(self,
                  first_um: float) -> tuple[FloatArray, PreisachMemory, FloatArray, FloatArray]:
        """Return the voltages from rest down to the lowest and up to the first displacement.

        They are followed by the state at their end: the memory of the hysteresis, and displacement
        and state of the slow part.
        """
        lowest_v, start_v = self.hysteresis.voltage_min_v, self.stage.rest_voltage_v
        reachable_um = np.clip(first_um, *self.hysteresis.output_range_um)
        first_v = self.hysteresis.invert([reachable_um])[0]
        check_range(np.array([first_v]), lowest_v, self.stage.voltage_range_v[1], VOLTAGE)
        ramp = minimum_jerk(aligned_samples(RAMP_S, self.sample_period_s))
        voltage_v = np.r_[start_v + (lowest_v - start_v) * ramp,
                          lowest_v + (first_v - lowest_v) * ramp,
                          np.full(aligned_samples(REST_S, self.sample_period_s), first_v)]
        memory = self.model.memory(start_v).hysteresis
        before = equilibrium_state(self.slow, memory.hysteresis_um)
        hysteresis_um = self.hysteresis.simulate(
            self.model.amplified(voltage_v, self.sample_period_s), memory)
        return voltage_v, memory, *continue_linear(self.sampled_slow, hysteresis_um, before)


class _FadedIn(Trajectory):
    """Expected displacement of a run: its approach, and then a reference faded in from a level."""

    def __init__(self, once_um: FloatArray, level_um: float, reference: Trajectory, approach: int,
                 fade_samples: int) -> None:
        self._once_um, self._level_um, self._reference = once_um, level_um, reference
        self._approach, self._fade_samples = approach, fade_samples

    def sample(self, first: int, count: int) -> FloatArray:
        """See `Trajectory.sample`."""
        once_um = self._once_um[max(first, 0):max(first + count, 0)]
        at = first + once_um.size - self._once_um.size
        reference_um = self._reference.sample(at - self._approach, count - once_um.size)
        if at < self._fade_samples:
            fade = smooth_rise(np.arange(at, at + reference_um.size) / self._fade_samples)
            reference_um = self._level_um + fade * (reference_um - self._level_um)
        return np.r_[once_um, reference_um]

    def survey(self, samples: int) -> FloatArray:
        """See `Trajectory.survey`."""
        return self._reference.survey(samples)


class _Scaled(Trajectory):
    """A trajectory that is scaled about a centre."""

    def __init__(self, trajectory: Trajectory, centre_um: float, scale: float) -> None:
        self._trajectory, self._centre_um, self._scale = trajectory, centre_um, scale

    def sample(self, first: int, count: int) -> FloatArray:
        """See `Trajectory.sample`."""
        return self._scaled(self._trajectory.sample(first, count))

    def survey(self, samples: int) -> FloatArray:
        """See `Trajectory.survey`."""
        return self._scaled(self._trajectory.survey(samples))

    def _scaled(self, displacement_um: FloatArray) -> FloatArray:
        return self._centre_um + self._scale * (displacement_um - self._centre_um)
