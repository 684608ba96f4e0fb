# SPDX-License-Identifier: BSD-3-Clause
"""Voltage for a general reference, computed chunk by chunk while the stage plays."""

from dataclasses import dataclass, replace

import control
import numpy as np

from piezo_controller.lead_in import (
    ALIGNMENT_SAMPLES,
    FADE_S,
    RAMP_S,
    aligned_samples,
    check_amplifier_range,
)
from piezo_controller.preview_inverse import PREVIEW_SAMPLES, PreviewInverse, preview_inverse
from piezo_controller.reach import (
    STATIC_DISPLACEMENT,
    VOLTAGE,
    OutOfReach,
    check_range,
    check_slew,
    unreachable,
)
from piezo_controller.smooth_rise import minimum_jerk
from piezo_models.cascade import StageModel
from piezo_models.linear import continue_linear, equilibrium_state, zoh

REST_S = 0.02
LEAD_IN_S = 0.15
CHUNK_SAMPLES = 4000
# What the compensation of an effect looks at before and after the samples it compensates.
EFFECT_MARGIN_SAMPLES = 80


@dataclass(frozen=True, eq=False)
class StreamPlan:
    """What to play first, and where the voltages of the reference come from.

    Attributes
    ----------
    once_voltage_v : ndarray, shape (n,)
        Down to the model's lowest voltage, which wipes out the hysteresis' past, and up to the
        first value of the reference.
    displacement_um : ndarray, shape (M,)
        To expect, from the first sample on to `margin_samples` behind the last.
    feedback_start_sample, begin_sample : int
        Where feedback may begin; where the lead-in has ended and the reference begins.
    left_alone : tuple of str
        Effects of the model that are not compensated.
    inverse : OnlineInverse
        As it is when `once_voltage_v` has been played.
    margin_samples : int
        How far ahead it looks.
    """

    once_voltage_v: np.ndarray
    displacement_um: np.ndarray
    begin_sample: int
    left_alone: tuple
    inverse: "OnlineInverse"
    margin_samples: int

    @property
    def feedback_start_sample(self):
        """See the class."""
        return len(self.once_voltage_v)

    def expected_um(self, first_sample, count):
        """Displacements to expect of `count` samples from `first_sample` on (um)."""
        wanted = np.arange(first_sample, first_sample + count)
        return self.displacement_um[np.minimum(wanted, self.displacement_um.size - 1)]

    def chunks(self, chunk_samples=CHUNK_SAMPLES):
        """Yield the voltages behind `once_voltage_v`, chunk by chunk.

        A chunk is computed from the reference up to its end and the preview, no further.
        """
        start, inverse = self.feedback_start_sample, self.inverse.copy()
        end = self.displacement_um.size - self.margin_samples
        inverse.look_ahead(self.displacement_um[start:start + self.margin_samples])
        for first in range(start, end, chunk_samples):
            last = min(first + chunk_samples, end)
            yield inverse.continue_with(
                self.displacement_um[first + self.margin_samples:last + self.margin_samples])


def plan_stream(reference_um, model, method="least_squares", *, voltage_range_v=(-20.0, 120.0),
                slew_limit_v_per_s=2e6, sample_period_s=25e-6, start_voltage_v=0.0,
                preview_samples=PREVIEW_SAMPLES):
    """Plan the voltage that makes a model at rest follow any reference, with a short preview.

    Everything is computed in a first pass to know that it stays within the limits, and again
    while it is played.

    Parameters
    ----------
    reference_um : ndarray, shape (M,)
        Displacement: `lead_in_samples`, the samples of the run, `stream_margin` samples. It is
        faded in over the first part of the lead-in.
    model : piezo_models.cascade.StageModel
    method : str
        Of `preview_inverse`.
    voltage_range_v : tuple of float
    slew_limit_v_per_s, sample_period_s, start_voltage_v : float
    preview_samples : int

    Returns
    -------
    StreamPlan

    Raises
    ------
    UnreachableReference
        The voltage would leave the range or exceed the slew limit; names what is reachable.
    ValueError
        The model's range does not fit the amplifier's, or `method` does not fit the model.
    """
    check_amplifier_range(model.hysteresis, voltage_range_v, start_voltage_v)
    planner = _StreamPlanner(model, method, voltage_range_v[1], slew_limit_v_per_s,
                             sample_period_s, start_voltage_v, preview_samples)
    reference_um = np.asarray(reference_um, dtype=float)
    try:
        return planner.plan(reference_um)
    except OutOfReach as reason:
        raise unreachable(planner, reference_um, reason) from None


def lead_in_samples(sample_period_s=25e-6):
    """Samples of a reference before its beginning that `plan_stream` takes."""
    return aligned_samples(LEAD_IN_S, sample_period_s)


def stream_margin(model, preview_samples=PREVIEW_SAMPLES):
    """Samples of a reference behind its end that `plan_stream` takes: the whole preview."""
    return preview_samples + (EFFECT_MARGIN_SAMPLES if _compensated(model) else 0)


def join(stretches, transition_samples):
    """Lead from each trajectory over to the next without a jump of any derivative up to the second.

    Parameters
    ----------
    stretches : list of ndarray
        The last `transition_samples` of each are faded into the first of the next.
    transition_samples : int

    Returns
    -------
    ndarray
    """
    joined, rise = stretches[0], minimum_jerk(transition_samples)
    for following in stretches[1:]:
        before, overlap = joined[:-transition_samples], joined[-transition_samples:]
        after = following[:transition_samples]
        joined = np.r_[before, overlap + rise * (after - overlap), following[transition_samples:]]
    return joined


@dataclass
class OnlineInverse:
    """The inverse of a model with its memory: displacements in, voltages out.

    The dynamics by a filter with preview, the slow creep by its causal inverse, the hysteresis by
    its exact inverse; the states of all three go on from chunk to chunk.
    """

    model: StageModel
    preview: PreviewInverse
    creep_inverse: control.StateSpace
    sample_period_s: float
    preview_state: np.ndarray
    creep_state: np.ndarray
    hysteresis: object
    window_um: np.ndarray

    def copy(self):
        """An inverse with a memory of its own."""
        return replace(self, hysteresis=self.hysteresis.copy())

    def look_ahead(self, displacement_um):
        """Take the first displacements, before any voltage is known."""
        self.continue_with(displacement_um, look_ahead_only=True)

    def continue_with(self, displacement_um, look_ahead_only=False):
        """Voltages for which the stage will have followed the next displacements.

        Parameters
        ----------
        displacement_um : ndarray, shape (n,)
            What the sensor is to measure: the next of the preview.

        Returns
        -------
        voltage_v : ndarray, shape (n,)
            Of the samples a preview earlier.

        Raises
        ------
        OutOfReach
        """
        wanted_um, self.preview_state = self.preview.apply(
            self._before_effects(displacement_um), self.preview_state)
        if look_ahead_only:
            return None
        hysteresis_um, self.creep_state = continue_linear(
            self.creep_inverse, wanted_um, self.creep_state)
        hysteresis = self.model.hysteresis
        check_range(hysteresis_um, *hysteresis.output_range_um, STATIC_DISPLACEMENT)
        return hysteresis.invert(hysteresis_um, self.hysteresis)

    def _before_effects(self, displacement_um):
        """The displacement in front of the effects on it, a margin earlier."""
        effects = _compensated(self.model)
        if not effects:
            return displacement_um
        window_um = np.r_[self.window_um, displacement_um]
        self.window_um = window_um[-2 * EFFECT_MARGIN_SAMPLES:]
        # Mirrored it is a period, which is what effects compensate.
        period_um = np.r_[window_um, window_um[::-1]]
        for effect in effects:
            try:
                period_um = effect.compensate(period_um, self.sample_period_s)
            except ValueError as error:
                raise OutOfReach(str(error)) from None
        return period_um[EFFECT_MARGIN_SAMPLES:window_um.size - EFFECT_MARGIN_SAMPLES]


class _StreamPlanner:
    """Plans general references for one model; see `plan_stream`."""

    def __init__(self, model, method, highest_v, slew_limit_v_per_s, sample_period_s,
                 start_voltage_v, preview_samples):
        self.model = model
        self.hysteresis = model.hysteresis
        self.highest_v = highest_v
        self.slew_limit_v_per_s = slew_limit_v_per_s
        self.sample_period_s = sample_period_s
        self.start_voltage_v = start_voltage_v
        self.preview = preview_inverse(model.dynamics.state_space(model.effects_at("modes")),
                                       sample_period_s, method, preview_samples)
        self.slow = model.creep.state_space()
        for effect in model.effects_at("linear"):
            self.slow = effect.state_space() * self.slow
        self.sampled_slow = zoh(self.slow, sample_period_s)
        self.margin = stream_margin(model, self.preview.preview_samples)
        compensated = _compensated(model)
        self.left_alone = tuple(
            effect.name for effect in model.effects
            if effect not in compensated and effect.place not in ("modes", "linear"))

    def plan(self, reference_um):
        """The plan for one reference; raises `OutOfReach`."""
        once_v, memory, slow_um, slow_state = self._lead_in(reference_um[0])
        rest_um = slow_um[-1]
        level_um = self.model.sensed(np.full(ALIGNMENT_SAMPLES, rest_um), self.sample_period_s)[-1]
        fade_samples = aligned_samples(FADE_S, self.sample_period_s)
        fade = np.ones(reference_um.size)
        fade[:fade_samples] = minimum_jerk(fade_samples)
        inverse = OnlineInverse(
            self.model, self.preview, _inverse(self.sampled_slow), self.sample_period_s,
            self.preview.state(rest_um), slow_state, memory,
            np.full(2 * EFFECT_MARGIN_SAMPLES, level_um))
        plan = StreamPlan(
            once_v, np.r_[slow_um, level_um + fade * (reference_um - level_um)],
            once_v.size + lead_in_samples(self.sample_period_s), self.left_alone, inverse,
            self.margin)
        last_v = once_v[-1:]
        for voltage_v in plan.chunks():
            check_range(voltage_v, self.hysteresis.voltage_min_v, self.highest_v, VOLTAGE)
            check_slew(np.r_[last_v, voltage_v], self.sample_period_s, self.slew_limit_v_per_s)
            last_v = voltage_v[-1:]
        return plan

    def _lead_in(self, first_um):
        """Voltages from rest to the lowest and up to the first displacement, and what they leave.

        That is the memory of the hysteresis, and displacement and state of the slow part.
        """
        lowest_v = self.hysteresis.voltage_min_v
        reachable_um = np.clip(first_um, *self.hysteresis.output_range_um)
        first_v = self.hysteresis.invert([reachable_um])[0]
        check_range(np.array([first_v]), lowest_v, self.highest_v, VOLTAGE)
        ramp = minimum_jerk(aligned_samples(RAMP_S, self.sample_period_s))
        voltage_v = np.r_[self.start_voltage_v + (lowest_v - self.start_voltage_v) * ramp,
                          lowest_v + (first_v - lowest_v) * ramp,
                          np.full(aligned_samples(REST_S, self.sample_period_s), first_v)]
        memory = self.model.memory(self.start_voltage_v).hysteresis
        before = equilibrium_state(self.slow, memory.hysteresis_um)
        hysteresis_um = self.hysteresis.simulate(
            self.model.amplified(voltage_v, self.sample_period_s), memory)
        return voltage_v, memory, *continue_linear(self.sampled_slow, hysteresis_um, before)


def _compensated(model):
    """The effects that a stream compensates, the last first."""
    return tuple(effect for place in ("sensor", "displacement")
                 for effect in reversed(model.effects_at(place)) if effect.follows_voltage)


def _inverse(system):
    """Inverse of a discrete system that passes its input on at once, in the same states."""
    a, b, c, d = system.A, system.B, system.C, system.D
    return control.ss(a - b @ c / d, b / d, -c / d, 1 / d, system.dt)
