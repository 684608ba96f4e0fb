# SPDX-License-Identifier: BSD-3-Clause
"""A feedforward that learns while the stage plays it: iterations first, then the best of them."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray
from piezo_controller.feedforward.feasibility import Infeasible, UnreachableReference
from piezo_controller.feedforward.periodic import FeedforwardPlan, FeedforwardPlanner
from piezo_controller.feedforward.plan import TrackingPlan
from piezo_controller.learning.periodic_learner import PeriodicLearner
from piezo_controller.references.smooth_rise import minimum_jerk

FADE_S = 0.01
SETTLE_S = 0.04
MEASURE_S = 0.05
# Time from the end of the measurement to that of the loaded voltages, for loading when paced.
SPARE_S = 0.1
SPARE_AT_THE_END_S = 1.0
HALVINGS = 6


class LearningFeedforward(TrackingPlan):
    """Voltages of a learning run, part by part, and what to expect.

    Each part plays one iterate, faded in from the previous one: it settles, is measured, and
    continues while the next is computed. The learner is that of the same reference, one period,
    (P,). After some iterations at most, the last part plays the best one for `run_samples`.

    `iteration` is the number of the present one, 0 once the best is played; `begin_sample` is where
    that has settled, the latest possible until it is known. Raises `UnreachableReference` if the
    amplifier cannot follow half of the reference's amplitude according to the model.
    """

    streamed = open_ended = True
    period_voltage_v = np.empty(0)

    def __init__(self, planner: FeedforwardPlanner, reference_um: ArrayLike,
                 learner: PeriodicLearner, iterations: int, run_samples: int,
                 samples_per_tick: int = 40) -> None:
        self._planner, self._learner = planner, learner
        self._reference_um = np.asarray(reference_um, dtype=float)
        self._iterations = iterations
        self._run_samples = run_samples
        rate_hz = 1.0 / planner.sample_period_s
        # Whole ticks and whole periods, as the feedback repeats with both.
        repeat = math.lcm(self._reference_um.size, samples_per_tick)
        self._fade = round(FADE_S * rate_hz)
        self._measure = max(2, math.ceil(MEASURE_S * rate_hz / repeat)) * repeat
        self._settled = math.ceil((FADE_S + SETTLE_S) * rate_hz / repeat) * repeat
        self._part = (self._settled + self._measure
                      + math.ceil(SPARE_S * rate_hz / repeat) * repeat)
        plan = self._plan_first()
        self.once_voltage_v = plan.once_voltage_v
        self.feedback_start_sample = plan.feedback_start_sample
        self.uncompensated = plan.uncompensated
        self._expected_plan = plan
        self._period_v = plan.period_voltage_v
        self._loaded = plan.begin_sample
        self.begin_sample = plan.begin_sample + iterations * self._part + self._settled
        self.iteration = 0
        self._taken_um: list[FloatArray] = []
        self._taken = 0
        self._window: tuple[int, int] | None = None
        self._remaining_samples: int | None = None

    def _plan_first(self) -> FeedforwardPlan:
        """Plan with the initial correction, or with as much of the reference as is in reach."""
        alternating_um = self._reference_um - self._reference_um.mean()
        correction_um = self._learner.correction_um
        for step in range(HALVINGS):
            part = 1.0 - 0.1 * step
            played_um = part * correction_um - (1.0 - part) * alternating_um
            try:
                plan = self._planner.plan(self._reference_um, played_um)
            except Infeasible as error:
                reason = error
                continue
            self._correction_um = played_um
            self._learner.limit_to(played_um)
            return plan
        raise UnreachableReference(
            f"the amplifier cannot follow half of the reference of "
            f"{np.ptp(self._reference_um):.4g} um peak to peak: {reason}", 0.0)

    def continuation(self) -> Callable[[], FloatArray | None]:
        """Return the function that computes each next part."""
        return self.next_voltage_v

    def expected_um(self, first_sample: int, count: int) -> FloatArray:
        """Return the displacements to expect of `count` samples from `first_sample` on (um)."""
        return self._expected_plan.expected_um(first_sample, count)

    def travel_um(self, samples: int) -> float:
        """Return the peak-to-peak displacement of the first samples of the reference (um)."""
        return self._expected_plan.travel_um(samples)

    def take(self, displacement_um: FloatArray) -> None:
        """Take the samples that were measured next, from the run's first on."""
        first, window = self._taken, self._window
        self._taken += len(displacement_um)
        if window is not None and self._taken > window[0] and first < window[1]:
            self._taken_um.append(np.array(
                displacement_um[max(window[0] - first, 0):window[1] - first]))

    def next_voltage_v(self) -> FloatArray | None:
        """Return the next voltages after `once_voltage_v`.

        They are empty at the end; None while the measurement that they depend on is incomplete.
        """
        if self._remaining_samples is not None:
            return self._go_on(self._remaining_samples)
        if self._window is None:
            self.iteration = 1
            return self._load(self._part, self._period_v)
        if self._taken < self._window[1]:
            return None
        self._learner.learn(np.concatenate(self._taken_um))
        if self._learner.finished or self._learner.iterations >= self._iterations:
            self.iteration = 0
            self._learner.finished = self._learner.finished or "no further iteration was allowed"
            self._remaining_samples = self._run_samples + round(
                SPARE_AT_THE_END_S / self._planner.sample_period_s)
            self.begin_sample = self._loaded + self._settled
            return self._load(self._settled, self._plan(self._learner.best_um))
        self.iteration += 1
        voltage_v = self._plan(self._learner.correction_um)
        self._learner.limit_to(self._correction_um)
        return self._load(self._part, voltage_v)

    def _go_on(self, remaining_samples: int) -> FloatArray:
        """Return further voltages of the best iterate."""
        count = min(remaining_samples, self._part)
        self._remaining_samples = remaining_samples - count
        return self._load(count, self._period_v)

    def _plan(self, correction_um: FloatArray) -> FloatArray:
        """Plan a period for a correction, or for as much of its change as is feasible."""
        before_um, part = self._correction_um, 1.0
        for _ in range(HALVINGS):
            wanted_um = before_um + part * (correction_um - before_um)
            try:
                plan = self._planner.plan(self._reference_um, wanted_um)
            except Infeasible:
                part /= 2
                continue
            self._correction_um = wanted_um
            return plan.period_voltage_v
        return self._period_v

    def _load(self, count: int, period_v: FloatArray) -> FloatArray:
        """Return the next voltages, with a fade from the last period to a new one."""
        phase = np.arange(self._loaded, self._loaded + count) - self._expected_plan.begin_sample
        phase %= period_v.size
        voltage_v = period_v[phase]
        fade = min(self._fade, count)
        old_v = self._period_v[phase[:fade]]
        voltage_v[:fade] = old_v + minimum_jerk(self._fade)[:fade] * (voltage_v[:fade] - old_v)
        self._taken_um = []
        begin = self._loaded + self._settled
        self._window = begin, begin + self._measure
        self._loaded += count
        self._period_v = period_v
        return voltage_v
