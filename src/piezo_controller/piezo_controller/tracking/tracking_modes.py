# SPDX-License-Identifier: BSD-3-Clause
"""What is played in advance in each mode of tracking, and which feedback is added."""

from dataclasses import replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedforward.approach import FADE_S, StageClock
from piezo_controller.feedforward.periodic import FeedforwardPlan, plan_feedforward
from piezo_controller.feedforward.plan import TrackingPlan
from piezo_controller.references.kind import Reference, Watch
from piezo_controller.references.reference import sample_reference
from piezo_controller.references.smooth_rise import minimum_jerk
from piezo_models.cascade import StageModel

MODES = ("open_loop", "pid", "pi", "feedforward", "composite", "composite_single_rate",
         "learning")
FEEDBACK_METHODS = {"pid": "pid", "pi": "pi", "composite": "h_infinity",
                    "composite_single_rate": "h_infinity"}
"""Method of `design_feedback` for each mode with feedback."""


def plan_mode(mode: str, reference: Reference, model: StageModel, stage: StageClock,
              duration_s: float, watch: Watch | None = None) -> FeedforwardPlan:
    """Plan the voltages that the stage plays in one of `MODES`, whose periodic part has a duration.

    ``pid`` and ``pi`` hold the voltage of the reference's mean, and the rest comes from the
    feedback. ``composite_single_rate`` updates the feedforward once per tick, as often as the
    feedback. ``learning`` begins with the feedforward.

    Raises `InvalidReference` if the reference has no period of whole samples, or of whole ticks at
    a single rate, `UnreachableReference` if the voltage would exceed the limits, see
    `plan_feedforward`, and ValueError if the mode is unknown.
    """
    if mode not in MODES:
        raise ValueError(f"unknown mode {mode!r}: use one of {', '.join(MODES)}")
    reference_um = sample_reference(reference, stage.sample_rate_hz)

    def plan(wanted_um: FloatArray, kind: str = "feedforward",
             samples_held: int = 1) -> FeedforwardPlan:
        held = replace(stage, sample_rate_hz=stage.sample_rate_hz / samples_held)
        return plan_feedforward(wanted_um, model, kind, stage=held, duration_s=duration_s,
                                watch=watch)

    if mode in ("pid", "pi"):
        return _with_reference(plan(np.full(reference_um.size, reference_um.mean())),
                               reference_um, stage.sample_period_s)
    if mode == "composite_single_rate":
        held = stage.samples_per_tick
        slow = plan(sample_reference(reference, stage.sample_rate_hz / held), samples_held=held)
        return _held(slow, held, reference_um)
    return plan(reference_um, "open_loop" if mode == "open_loop" else "feedforward")


def _with_reference(plan: FeedforwardPlan, reference_um: FloatArray,
                    sample_period_s: float) -> FeedforwardPlan:
    """Return a plan that holds the mean, but expects the reference, faded in."""
    once = plan.reference_once_um.size
    fade_start = plan.feedback_start_sample
    fading = min(round(FADE_S / sample_period_s), once - fade_start)
    fade = np.r_[minimum_jerk(fading), np.ones(once - fade_start - fading)]
    expected_um = plan.reference_once_um.copy()
    phase = np.arange(fade_start - once, 0) % reference_um.size
    expected_um[fade_start:] += fade * (reference_um - reference_um.mean())[phase]
    return replace(plan, reference_once_um=expected_um, reference_period_um=reference_um)


def _held(plan: FeedforwardPlan, samples: int, reference_um: FloatArray) -> FeedforwardPlan:
    """Return a plan at the tick rate, resampled to the sample clock."""
    once = plan.reference_once_um.size
    expected_um = np.interp(np.arange(once * samples) / samples, np.arange(once),
                            plan.reference_once_um)
    repeats = plan.period_voltage_v.size * samples // reference_um.size
    return replace(
        plan, once_voltage_v=np.repeat(plan.once_voltage_v, samples),
        period_voltage_v=np.repeat(plan.period_voltage_v, samples),
        reference_once_um=expected_um, reference_period_um=np.tile(reference_um, repeats),
        feedback_start_sample=plan.feedback_start_sample * samples)


def feedback_room_v(plan: TrackingPlan, voltage_range_v: tuple[float, float]) -> float:
    """Return the largest feedback voltage (V), of either sign, that keeps within the range."""
    played_v = plan.period_voltage_v
    lowest_v, highest_v = voltage_range_v
    return float(min(played_v.min() - lowest_v, highest_v - played_v.max()))
