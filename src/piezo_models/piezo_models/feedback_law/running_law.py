# SPDX-License-Identifier: BSD-3-Clause
"""A running feedback law, for code that plays the voltages and receives the samples."""

from collections import deque
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from piezo_common.arrays import FloatArray
from piezo_models.feedback_law.feedback_law import (
    DeclaredPlant,
    FeedbackLaw,
    FeedbackLawError,
    InverseHysteresis,
    LinearBlock,
)
from piezo_models.feedback_law.law_kernels import EXPECTED, FADED, MEASURED, decide, take
from piezo_models.feedback_law.running_inverse import RunningInverse
from piezo_models.hysteresis.preisach import PreisachModel

# Ticks from which a law that takes over estimates its state; no law of this suite has a longer
# memory that its observer does not correct.
REMEMBERED_TICKS = 64
# Frequencies of the high-frequency gain of a block, as fractions of the sample rate.
QUICK = np.linspace(0.01, 0.5, 400)
LEAST_GAIN = 1e-6  # V per um
# A state whose relative change per sample is below this is taken as constant.
LEAST_CHANGE = 1e-6


class RunningLaw:
    """Evaluate a law from tick to tick, and from sample to sample if the law requires it.

    Call `begin` with the next planned voltages, play them with the returned ones added, and pass
    what was measured to `take`; `samples_at_once` is the number of samples of each call.

    The run begins at the rest voltage in V, reached from negative saturation. `largest_step_v` is
    the largest change of the feedback voltage from one tick to the next in V, and `stepped` is True
    if it limited the voltage. `error_um` is the mean error of the last tick, and `voltage_v` the
    feedback voltage in the present tick: the mean of the last output of `begin`.
    """

    def __init__(self, law: FeedbackLaw, samples_per_tick: int, rest_voltage_v: float = 0.0,
                 largest_step_v: float = np.inf) -> None:
        self.law = law
        self._samples_per_tick = samples_per_tick
        self._each_sample = not law.sample.empty
        self.samples_at_once = 1 if self._each_sample else samples_per_tick
        self._step_v = largest_step_v
        self.error_um = self.voltage_v = 0.0
        self.stepped = False
        tick, sample = law.tick, law.sample
        self._tick = tick.a, tick.b, tick.c, tick.d, np.ascontiguousarray(law.observer)
        self._state, self._work = np.zeros(tick.order), np.empty(tick.order)
        self._sample = (sample.a, sample.b, sample.c, sample.d,
                        np.zeros(sample.order), np.empty(sample.order))
        self._sample_state = self._sample[4]
        self._sample_observer = _observer(sample)
        self._none = np.zeros((0, 0)), *(np.zeros(0),) * 2, 0.0, *(np.zeros(0),) * 2
        self._once_um = np.ascontiguousarray(law.once_um)
        self._period_um = np.ascontiguousarray(law.period_um)
        # A tick is fed back as a whole, like by a remote controller, which gets blocks.
        self._start_sample = -(-law.start_sample // samples_per_tick) * samples_per_tick
        self._sums = np.zeros(3)
        self._fade_samples, self._initial_um, self._seen_um = law.fade_samples, 0.0, 0.0
        self._measured = self._played = self._decided_ticks = 0
        self._acts = False
        self._added_v = self._decided_v = self._acting_v = 0.0
        self._decisions = deque([0.0] * law.delay_ticks)
        self._past: deque[tuple[float, float]] = deque(maxlen=REMEMBERED_TICKS)
        self._feedback_v = np.zeros(self.samples_at_once)
        self._inverse = None if law.inverse is None else RunningInverse(law.inverse, rest_voltage_v)

    def begin(self, planned_v: FloatArray) -> FloatArray:
        """Return the voltages (V), (k,), to add to the next `samples_at_once` planned voltages.

        The same array is returned each time.
        """
        if self._played % self._samples_per_tick == 0:
            self._decisions.append(self._decided_v)
            self._acting_v = self._decisions.popleft()
            self._acts = self._acts or self._decided_ticks > self.law.delay_ticks
        self._played += len(planned_v)
        if not (self._acts or self._each_sample and self.begun):
            # No feedback yet: nothing is added, not even the rounding of an inverse.
            if self._inverse is not None:
                self._inverse.follow(planned_v)
            return self._feedback_v
        limit_v = self.law.max_feedback_v
        asked_v = self._acting_v + self._added_v
        wanted_v = min(max(asked_v, -limit_v), limit_v)
        self._sample_state += self._sample_observer * (wanted_v - asked_v)
        if self._inverse is None:
            self._feedback_v.fill(wanted_v)
            self.voltage_v = wanted_v
        else:
            last_v, step_v = self.voltage_v, self._step_v
            self.voltage_v, clipped_v = self._inverse.pass_on(
                wanted_v, planned_v, max(-limit_v, last_v - step_v), min(limit_v, last_v + step_v),
                self._feedback_v)
            self._sample_state += self._sample_observer * clipped_v
            self.stepped |= abs(self.voltage_v - last_v) >= step_v
        return self._feedback_v

    def correct(self, clipped_v: float) -> None:
        """Correct the states by the feedback voltage that was not played (anti-windup).

        Call it between `begin` and `take`, with the mean of the played voltage minus the requested
        one (V), if the amplifier's limits cut the voltage.
        """
        if not self.begun:
            return
        self.voltage_v += clipped_v
        if self._each_sample:
            self._sample_state += self._sample_observer * clipped_v
        else:
            self._state += self._tick[4] * clipped_v

    def take(self, displacement_um: FloatArray) -> None:
        """Process the next measured samples, shape (k,): a tick, or a part that ends with it."""
        sample = self._sample if self._measured >= self._start_sample else self._none
        if self._measured == self._start_sample:
            self._initial_um = self._first_error_um(displacement_um[0])
        self._added_v = take(displacement_um, self._measured, self._once_um, self._period_um,
                             self._start_sample, self._fade_samples, self._initial_um,
                             self._sums, *sample, self._added_v)
        self._measured += len(displacement_um)
        if self._measured % self._samples_per_tick:
            return
        self.error_um = float(
            self._sums[EXPECTED] - self._sums[MEASURED]) / self._samples_per_tick
        self._seen_um = self.error_um - float(self._sums[FADED]) / self._samples_per_tick
        self._sums[:] = 0.0
        if self.begun:
            self._decide()

    def _first_error_um(self, displacement_um: float) -> float:
        """Return the initial error: that of the tick before, if there was one."""
        if self._measured:
            return self.error_um
        expected_um = self._once_um if self._once_um.size else self._period_um
        return float(expected_um[0] - displacement_um)

    @property
    def begun(self) -> bool:
        """Return True once a tick has been fed back."""
        return self._measured > self._start_sample

    def _decide(self) -> None:
        self._decided_ticks += 1
        self._decided_v, self.stepped = decide(
            self._seen_um, *self._tick, self._state, self._work, self._decided_v,
            self.law.max_feedback_v, self._step_v)
        self._past.append((self._seen_um, self._decided_v))

    def take_over(self, other: "RunningLaw") -> None:
        """Continue in place of another law, between two ticks and without a bump.

        The observer that prevents windup estimates the state with which the block at the tick's
        rate would have given the recent output of the other law. The block at the sample rate
        continues from the other's state if both blocks are equal; otherwise it starts at rest. The
        remaining step is removed by a change of the states. If a block has no state that gives a
        voltage, the other block gives its share too. Raises `FeedbackLawError` if this law passes
        an inverse whose past the other law does not provide, expects another run, has a lower limit
        than the present voltage, or begins later than now.
        """
        scale = self._volts_per_volt(other)
        self._check_follows(other, scale)
        if self._inverse is not None:
            self._inverse.take_over(other._inverse)
        past = [(error_um, scale * voltage_v) for error_um, voltage_v in other._past]
        for error_um, voltage_v in past:
            decide(error_um, *self._tick, self._state, self._work, voltage_v, np.inf, 0.0)
        self._past.extend(past)
        self._measured, self._played = other._measured, other._played
        self._decided_ticks, self._acts = other._decided_ticks, other._acts
        self.error_um, self.voltage_v = other.error_um, other.voltage_v
        self._seen_um = other._seen_um
        self._sums[:] = other._sums
        if other.begun:
            self._start_sample = other._start_sample
            self._fade_samples, self._initial_um = other._fade_samples, other._initial_um
        present = _Shares(scale * other._acting_v, scale * other._added_v)
        ahead = _Shares(scale * other._foreseen_v(), scale * other._foreseen_sample_v())
        self._acting_v, self._added_v = present.between(self.law)
        decided_v = [present._replace(tick_v=scale * voltage_v).between(self.law)[0]
                     for voltage_v in (*other._decisions, other._decided_v)]
        self._decided_v = decided_v.pop()
        kept = decided_v[-self.law.delay_ticks:] if self.law.delay_ticks else []
        self._decisions = deque(
            [self._decided_v] * (self.law.delay_ticks - len(kept)) + kept)
        self._sample_state[:] = scale * other._sample_state if _same(
            self.law.sample, other.law.sample) else 0.0
        tick_v, sample_v = ahead.between(self.law)
        self._state += _at_rest(self.law.tick) * (tick_v - self._foreseen_v())
        self._sample_state += _at_rest(self.law.sample) * (sample_v - self._foreseen_sample_v())

    def _check_follows(self, other: "RunningLaw", scale: float) -> None:
        """Reject a change of law at which the voltage would jump or the feedback would pause."""
        acting_v = abs(scale * min(max(other._acting_v + other._added_v, -other.law.max_feedback_v),
                                   other.law.max_feedback_v))
        if acting_v > self.law.max_feedback_v * (1.0 + 1e-9):
            raise FeedbackLawError(
                f"what is fed back is {acting_v:.3g} V for this law, more than its max_feedback_v "
                f"of {self.law.max_feedback_v:.3g} V: load it once the error is smaller")
        lengths = [(len(law.once_um), len(law.period_um)) for law in (self.law, other.law)]
        if lengths[0] != lengths[1]:
            raise FeedbackLawError(
                "the law expects {} and {} displacements where {} and {} are followed: design it "
                "for the same run, or load it between two runs".format(*lengths[0], *lengths[1]))
        if other.begun and other._measured <= self._start_sample:
            raise FeedbackLawError(
                f"start_sample of the law is {self.law.start_sample}, but sample "
                f"{other._measured} of the run is fed back already: load it between two runs")

    def _volts_per_volt(self, other: "RunningLaw") -> float:
        """Return the factor from the other law's voltage to this one's, for equal output."""
        inverses = self.law.inverse, other.law.inverse
        if inverses[0] is None or inverses[1] is None:
            return 1.0
        return inverses[1].gain_um_per_v / inverses[0].gain_um_per_v

    def _foreseen_v(self) -> float:
        """Return the next decision for a constant error."""
        tick = self.law.tick
        return float(tick.c @ self._state + tick.d * self._seen_um)

    def _foreseen_sample_v(self) -> float:
        """Return the next output of the block at the sample rate for a constant error."""
        sample = self.law.sample
        return float(sample.c @ self._sample_state + sample.d * self._seen_um)


class _Shares(NamedTuple):
    """Voltages of the blocks at the tick's and at the sample rate (V)."""

    tick_v: float
    sample_v: float

    def between(self, law: FeedbackLaw) -> tuple[float, float]:
        """Return the same total voltage, distributed to the blocks that have states."""
        if not law.sample.c.any():
            return self.tick_v + self.sample_v, 0.0
        return (self.tick_v, self.sample_v) if law.tick.c.any() else (
            0.0, self.tick_v + self.sample_v)


def _same(block: LinearBlock, other: LinearBlock) -> bool:
    return all(np.array_equal(getattr(block, part), getattr(other, part)) for part in "abcd")


def _at_rest(block: LinearBlock) -> FloatArray:
    """Return the state of 1 V that changes least without an error; zeros if there is none."""
    if not block.c.any():
        return np.zeros(block.order)
    change = block.a - np.eye(block.order)
    cost = change.T @ change + LEAST_CHANGE**2 * np.eye(block.order)
    state = np.linalg.solve(cost, block.c)
    return np.asarray(state / (block.c @ state))


def _observer(block: LinearBlock) -> FloatArray:
    """Return the gain of the Kalman predictor for an error and a voltage of equal accuracy.

    The voltage has the accuracy that the block's high-frequency gain gives it from the error. A
    much more accurate voltage would drive a block of high gain from limit to limit.
    """
    if not block.order:
        return np.zeros(0)
    b, c = block.b[:, None], block.c[None, :]
    quick = block.response(np.exp(2j * np.pi * QUICK))
    known_v = block.d**2 + max(float(np.mean(np.abs(quick) ** 2)), LEAST_GAIN**2)
    covariance = solve_discrete_are(block.a.T, c.T, b @ b.T, known_v, s=b * block.d)
    return np.asarray((block.a @ covariance @ c.T + b * block.d)[:, 0]
                      / (c @ covariance @ c.T + known_v).item())


COMPILED_TICKS = 3
"""Ticks to run for compilation; from the second one on, a law without delay acts."""


def compile_law() -> None:
    """Compile what is not compiled yet, so that no tick is delayed."""
    block = LinearBlock.of([0.0], [1.0], [1.0], [0.0])
    hysteresis = PreisachModel(0.0, 1.0, np.ones((1, 1)))
    for inverse in (None, InverseHysteresis(hysteresis, 1.0)):
        law = FeedbackLaw(block, np.zeros(1), 1.0, np.zeros(1), np.zeros(0),
                          DeclaredPlant(block, np.ones(1)), inverse=inverse)
        running = RunningLaw(law, 1)
        for _ in range(COMPILED_TICKS):
            running.begin(np.zeros(1))
            running.take(np.zeros(1))


