# SPDX-License-Identifier: BSD-3-Clause
"""The block at the sample rate: its limits, its peak gain, and how another law goes on from it."""

from dataclasses import replace

import control
import numpy as np
import pytest

from piezo_models.feedback_law.feedback_law import (
    DeclaredPlant,
    FeedbackLaw,
    FeedbackLawError,
    InverseHysteresis,
    LinearBlock,
)
from piezo_models.feedback_law.law_check import LARGEST_SENSITIVITY, check_law
from piezo_models.feedback_law.running_law import RunningLaw
from piezo_models.hysteresis.preisach import PreisachModel

SAMPLES, CLOCK_S = 10, 1e-4
INTEGRATOR = LinearBlock.of([1.0], [0.05], [1.0], [0.05])
OFFSET_UM = 3.0
STRAIGHT = PreisachModel(
    -100.0, 100.0, np.zeros((20, 20)), -100.0, reversible_um_per_v=np.ones(20))
"""Of 1 um/V, without hysteresis."""


def first_order(pole=0.8):
    """Return a plant of gain 1: x+ = pole x + (1 - pole) u."""
    return LinearBlock.of([pole], [1.0 - pole], [1.0], [0.0])


def law_of(sample=None, tick=None, limit_v=100.0, **changes):
    law = FeedbackLaw(
        tick or LinearBlock(), np.full(0 if tick is None else tick.order, 0.5), limit_v,
        np.zeros(1), np.zeros(0), DeclaredPlant(first_order(), np.ones(1)),
        sample=sample or LinearBlock())
    return replace(law, **changes)


class Loop:
    """A plant of the first order with an offset, led by laws sample by sample."""

    def __init__(self, law, offset_um=OFFSET_UM):
        self.running, self.offset_um = RunningLaw(law, SAMPLES), offset_um
        self.state_um, self.given_v, self.measured_um = 0.0, [], []

    def play(self, ticks):
        count = self.running.samples_at_once
        for _ in range(ticks * SAMPLES // count):
            part_um = []
            for value_v in self.running.begin(np.zeros(count)):
                part_um.append(self.state_um + self.offset_um)
                self.state_um = 0.8 * self.state_um + 0.2 * value_v
                self.given_v.append(value_v)
            self.running.take(np.array(part_um))
            self.measured_um += part_um
        return np.array(self.given_v)

    def replace(self, law):
        following = RunningLaw(law, SAMPLES)
        following.take_over(self.running)
        self.running = following


@pytest.mark.parametrize("inverse", [None, InverseHysteresis(STRAIGHT, 1.0)],
                         ids=["alone", "behind an inverse"])
def test_without_a_limit_the_observer_changes_nothing(inverse):
    """The integral of the error of the sample before, summed by hand."""
    loop = Loop(law_of(INTEGRATOR, inverse=inverse))
    given_v = loop.play(30)
    expected_v = -0.05 * np.cumsum(np.array(loop.measured_um))[:-1]
    np.testing.assert_allclose(given_v[1:], expected_v, atol=1e-12)


@pytest.mark.parametrize("seconds", [0.1, 1.0])
def test_an_integral_at_its_limit_does_not_wind_up(seconds):
    """However long it was at its limit, it comes back as soon as the error has changed its sign."""
    loop = Loop(law_of(INTEGRATOR, limit_v=2.0), offset_um=OFFSET_UM)
    held_v = loop.play(round(seconds / CLOCK_S) // SAMPLES)
    assert held_v[-1] == -2.0
    # With room to spare: the error of -1 um needs +1 V.
    loop.offset_um = -1.0
    left_v = loop.play(8)[len(held_v):]
    # An integral that had summed on would stay at its limit for seconds * 0.05 / (0.3 * 25 us).
    assert np.flatnonzero(left_v > -1.9)[0] < 20
    assert abs(loop.play(30)[-1] - 1.0) < 0.05


def test_the_observer_of_an_integral_is_the_predictor_of_kalman():
    """One state, by hand: the covariance p of x+ = x + b w, y = c x + d w + v."""
    running = RunningLaw(law_of(INTEGRATOR), SAMPLES)
    b, d = 0.05, 0.05
    # v is as large as what the block makes of errors from 1 to 50 % of the sample rate.
    points = np.exp(2j * np.pi * np.linspace(0.01, 0.5, 400))
    v = np.mean(np.abs(d + b / (points - 1)) ** 2)
    # p = p + b^2 - (p + b d)^2 / (p + d^2 + v), the larger root of a square equation.
    p = (b * b - 2 * b * d + np.sqrt((b * b - 2 * b * d)**2
                                     + 4 * (b * b * (d * d + v) - b * b * d * d))) / 2
    gain = (p + b * d) / (p + d * d + v)
    np.testing.assert_allclose(running._sample_observer, [gain], rtol=1e-9)


@pytest.mark.parametrize("gain", [1e-3, 1.0, 1e3])
def test_the_observer_does_not_depend_on_the_unit_of_the_voltage(gain):
    louder = replace(INTEGRATOR, c=gain * INTEGRATOR.c, d=gain * INTEGRATOR.d)
    usual, other = (RunningLaw(law_of(block), SAMPLES)._sample_observer
                    for block in (INTEGRATOR, louder))
    np.testing.assert_allclose(gain * other, usual, rtol=1e-9)


def test_an_observed_block_forgets_what_was_cut_off():
    """All eigenvalues of A - L C lie within the unit circle, whatever stable block it is."""
    rng = np.random.default_rng(0)
    for order in (1, 3, 8):
        for _ in range(5):
            a = rng.normal(size=(order, order))
            a *= rng.uniform(0.5, 1.0) / np.abs(np.linalg.eigvals(a)).max()
            block = LinearBlock.of(a, rng.normal(size=order), rng.normal(size=order), [0.3])
            observer = RunningLaw(law_of(block), SAMPLES)._sample_observer
            assert np.abs(np.linalg.eigvals(a - np.outer(observer, block.c))).max() < 1.0


def brute_force_peak(block, pole=0.8):
    """Return the largest steady amplitude of the error under sines of 1 um, played one by one."""
    frequency = np.linspace(0.002, 0.5, 400)
    plant_um, held_v = np.zeros((2, frequency.size), dtype=complex)
    state = np.zeros((block.order, frequency.size), dtype=complex)
    for n in range(4000):
        disturbed_um = plant_um + np.exp(2j * np.pi * frequency * n)
        plant_um = pole * plant_um + (1 - pole) * held_v
        held_v = block.c @ state - block.d * disturbed_um
        state = block.a @ state - np.outer(block.b, disturbed_um)
    return np.abs(disturbed_um).max()


def test_the_peak_of_the_errors_is_that_of_sines_played_one_by_one():
    block = LinearBlock.of([1.0], [1.0], [0.25], [0.9])
    assert 1.2 < brute_force_peak(block) < LARGEST_SENSITIVITY
    low, high = 1.0, 10.0
    for _ in range(20):
        factor = (low * high) ** 0.5
        louder = replace(block, c=factor * block.c, d=factor * block.d)
        try:
            check_law(law_of(louder), SAMPLES)
            low = factor
        except FeedbackLawError:
            high = factor
    with pytest.raises(FeedbackLawError, match="times as large"):
        check_law(law_of(replace(block, c=high * block.c, d=high * block.d)), SAMPLES)
    assert brute_force_peak(louder) == pytest.approx(LARGEST_SENSITIVITY, rel=0.03)


def test_the_sample_that_a_block_acts_late_counts():
    """Of u = -k y on x+ = p x + (1 - p) u', u' one sample old: z (z - p) + k (1 - p) = 0."""
    pole = 0.8
    # The product of both roots is k (1 - p): stable below 1, where they are complex.
    critical = 1.0 / (1.0 - pole)
    roots = np.abs(np.roots([1.0, -pole, 0.999 * critical * (1 - pole)]))
    assert roots.max() < 1.0
    with pytest.raises(FeedbackLawError, match="not stable"):
        check_law(law_of(LinearBlock(d=1.001 * critical)), SAMPLES)
    with pytest.raises(FeedbackLawError, match="times as large"):
        check_law(law_of(LinearBlock(d=0.999 * critical)), SAMPLES)
    # Without that sample the loop would be stable up to (1 + p) / (1 - p), nearly twice as much.
    loud = control.feedback(
        control.ss(pole, 1 - pole, 1, 0, CLOCK_S), control.ss([], [], [], [[1.2 * critical]],
                                                              CLOCK_S))
    assert np.abs(loud.poles()).max() < 1.0


def test_the_same_block_goes_on_as_if_nothing_had_been_replaced():
    kept, replaced = Loop(law_of(INTEGRATOR)), Loop(law_of(INTEGRATOR))
    for loop in kept, replaced:
        loop.play(2)
    replaced.replace(law_of(INTEGRATOR, plant=DeclaredPlant(first_order(), np.array([1.1]))))
    np.testing.assert_array_equal(kept.play(5), replaced.play(5))


@pytest.mark.parametrize("before", [{"sample": INTEGRATOR}, {"tick": INTEGRATOR},
                                    {"sample": INTEGRATOR, "tick": LinearBlock(d=0.1)}])
@pytest.mark.parametrize("after", [
    {"sample": LinearBlock.of([1.0, 0.2, 0.0, 0.5], [0.02, 0.4], [1.0, 0.1], [0.01])},
    {"tick": LinearBlock.of([1.0], [0.1], [1.0], [0.1])},
    {"sample": INTEGRATOR, "tick": LinearBlock(d=0.1)}])
def test_another_block_goes_on_without_a_bump(before, after):
    loop = Loop(law_of(**before))
    loop.play(25)
    loop.replace(law_of(**after))
    given_v = loop.play(60)
    at = 25 * SAMPLES
    assert abs(given_v[at - 1]) > 2.0
    # A block that began anew would go back to zero, by more than 2 V.
    assert np.abs(np.diff(given_v[at - 1:at + 3 * SAMPLES])).max() < 0.35
    assert given_v[-1] == pytest.approx(-OFFSET_UM, abs=0.05)


def test_a_law_of_less_room_than_what_acts_is_refused():
    loop = Loop(law_of(INTEGRATOR))
    loop.play(30)
    with pytest.raises(FeedbackLawError, match="more than its max_feedback_v of 1 V: load it once"):
        loop.replace(law_of(INTEGRATOR, limit_v=1.0))
    loop.replace(law_of(INTEGRATOR, limit_v=4.0))


def test_a_law_that_is_replaced_at_its_limit_leaves_it_as_before():
    """Saturated: the next law with the same room goes on at the limit, and comes back as soon."""
    loops = [Loop(law_of(INTEGRATOR, limit_v=2.0)) for _ in range(2)]
    for loop in loops:
        loop.play(100)
    loops[1].replace(law_of(INTEGRATOR, limit_v=2.0))
    for loop in loops:
        loop.offset_um = -1.0
    np.testing.assert_allclose(loops[0].play(20), loops[1].play(20), atol=1e-9)


def test_a_law_that_would_begin_later_is_refused():
    loop = Loop(law_of(INTEGRATOR))
    loop.play(3)
    with pytest.raises(FeedbackLawError, match="start_sample of the law is 500, but sample 30"):
        loop.replace(law_of(INTEGRATOR, start_sample=500))
