# SPDX-License-Identifier: BSD-3-Clause
"""Probabilities of alternatives against what Gaussian errors of known variance say."""

import numpy as np
import pytest
from scipy.special import expit

from piezo_identification.diagnosis.joint.probabilities import (
    Evidence,
    listed_probabilities,
    probabilities,
)
from piezo_identification.fitting.joint_fit import correlated_scale
from piezo_identification.fitting.model_weights import HeldOut

NOISE_UM = 0.01
PASSING_UM = [1.2 * NOISE_UM]
STRETCH = np.repeat(np.arange(40), 25)


def evidence(label, mean_square_um2, determined, samples=400):
    """Leave the same of every stretch, of which a bootstrap then draws no other ratio."""
    left_um = np.sqrt(mean_square_um2) * np.resize([1.0, -1.0], samples)
    return Evidence(label, (HeldOut(left_um, np.arange(samples) * 40 // samples),), determined)


def shares(*alternatives, samples=400):
    return probabilities(
        [evidence(*each, samples) for each in alternatives], [0.0], PASSING_UM)


def test_they_sum_to_one_and_the_largest_comes_first():
    found = shares(("none", 4e-4, 0), ("delay", 1e-4, 1), ("creep", 1.1e-4, 3))
    assert sum(found.values()) == pytest.approx(1.0)
    assert list(found) == sorted(found, key=found.get, reverse=True)
    assert next(iter(found)) == "delay"
    assert found["none"] < 1e-6


def test_what_explains_nothing_is_less_probable_by_what_its_numbers_cost():
    found = shares(("none", 1e-4, 0.0), ("delay", 1e-4, 3.0))
    assert found["none"] / found["delay"] == pytest.approx(np.exp(3.0))


def test_what_the_model_is_known_to_be_wrong_by_tells_no_alternatives_apart():
    alternatives = [evidence("delay", 1.02e-4, 0.0, 1000), evidence("creep", 1e-4, 0.0, 1000)]
    sure, unsure = (probabilities(alternatives, [0.0], PASSING_UM, [wrong_um])
                    for wrong_um in (0.0, 10.0 * NOISE_UM))
    assert sure["creep"] > 0.99 * 0.95
    assert unsure["creep"] / unsure["delay"] == pytest.approx(np.exp(10.0 / 101.0), rel=0.01)


def test_fewer_independent_samples_tell_less():
    alternatives = ("none", 1.1e-4, 0.0), ("delay", 1e-4, 2.0)
    many, few = (shares(*alternatives, samples=number)["delay"] for number in (920, 40))
    assert many > 0.9 > 0.5 > few


def test_an_alternative_in_two_ways_has_the_probability_of_both():
    found = shares(("none", 1e-4, 0), ("delay", 1e-4, 0), ("delay", 1e-4, 0))
    assert found["delay"] == pytest.approx(2.0 * found["none"])


@pytest.mark.parametrize(("left", "is_believed"), [(1.0, False), (1.15, False), (1.5, True)])
def test_something_else_is_believed_where_more_is_left_than_passes_for_noise(left, is_believed):
    found = shares(("none", 16e-4, 0), ("delay", (left * NOISE_UM) ** 2, 1))
    assert (found["something_else"] > 0.5) is is_believed


def test_a_share_of_a_large_error_does_not_pass_for_noise():
    # 489 nm beside 9 nm of noise were once explained, as they are little of 4369 nm.
    found = probabilities(
        [evidence("none", 4.369**2, 0, 40), evidence("vibration_mode", 0.489**2, 3, 40)],
        [0.0], [np.hypot(0.009, 0.8 * 0.009)])
    assert found["something_else"] > 0.99


def test_errors_that_are_alike_count_once():
    generator = np.random.default_rng(5)
    white = generator.normal(size=100_000)
    assert correlated_scale(white) == pytest.approx(1.0, rel=0.3)
    alike = np.repeat(generator.normal(size=1000), 100)
    # A hundred equal samples tell as much as one: the scale grows by the root of a hundred.
    assert correlated_scale(alike) == pytest.approx(10.0, rel=0.3)


@pytest.mark.parametrize(("left_um", "noise_um", "wrong_um", "is_believed"), [
    (0.0040, 0.0020, 0.0030, False),  # as much as the model declares
    (0.0055, 0.0020, 0.0030, False),  # a little more than it declares
    (0.0200, 0.0020, 0.0030, True),
    (0.489, 0.009, 0.009, True),
    (0.0040, 0.0020, 0.0, True),  # the model declares nothing
])
def test_a_rest_passes_that_is_no_larger_than_what_the_model_is_known_to_be_wrong_by(
        left_um, noise_um, wrong_um, is_believed):
    found = probabilities([evidence("none", left_um**2, 0, 1000)], [1e-4], [1.28 * noise_um],
                          [wrong_um])
    assert (found["something_else"] > 0.5) is is_believed


def test_the_probability_of_something_else_rises_steadily_beyond_what_is_declared():
    # The figures of docs/diagnosis.md.
    wrong_um = 0.003
    shares = [
        probabilities([evidence("none", 0.0025**2 + (times * wrong_um) ** 2, 0, 1000)], [0.0],
                      [0.0025], [wrong_um])["something_else"]
        for times in (1.0, 1.5, 2.0, 2.5)]
    assert shares == pytest.approx([0.09, 0.31, 0.88, 0.98], abs=0.01)


def left_by(random, wrong_by):
    return HeldOut(random.normal(size=STRETCH.size) + wrong_by, STRETCH)


def chances(left, penalties=(0.0, 0.0), least_um=0.0):
    alternatives = [Evidence("", (each,), cost) for each, cost in zip(left, penalties, strict=True)]
    return listed_probabilities(alternatives, [least_um])


def test_with_white_errors_the_ratio_is_that_of_the_likelihoods():
    random = np.random.default_rng(1)
    noise = random.normal(size=STRETCH.size)
    difference = 0.01 * np.sign(random.normal(size=STRETCH.size))
    found, _ = chances([HeldOut(noise, STRETCH), HeldOut(noise + difference, STRETCH)])
    squares = [np.mean(noise**2), np.mean((noise + difference) ** 2)]
    exact = expit(0.5 * STRETCH.size * np.log(squares[1] / squares[0]))
    # The bootstrap is never surer than the likelihoods, and of little evidence nearly as sure.
    assert abs(found - 0.5) <= abs(exact - 0.5) + 0.01
    assert found == pytest.approx(exact, abs=0.08)


def test_one_stretch_that_speaks_for_an_alternative_is_less_than_all_of_them():
    random = np.random.default_rng(2)
    noise = random.normal(size=STRETCH.size)
    right = HeldOut(noise, STRETCH)
    sign = np.sign(random.normal(size=STRETCH.size))
    everywhere = HeldOut(noise + 0.12 * sign, STRETCH)
    # The same sum of squares, but the rest of the stretches says a little less against it.
    once = HeldOut(noise + 0.12 * np.sqrt(40) * sign * (STRETCH == 7), STRETCH)
    assert chances([right, everywhere])[0] > 0.95
    assert chances([right, once])[0] < chances([right, everywhere])[0]


def test_an_effect_that_takes_up_an_error_within_the_accuracy_of_the_model_is_not_bought():
    """Many rows show an error that is alike in each stretch; it may look like any effect."""
    random = np.random.default_rng(5)
    noise, shape = random.normal(size=STRETCH.size), random.normal(size=40)[STRETCH]

    def chance_of_none(error, accuracy):
        left = [HeldOut(noise + error * shape, STRETCH), HeldOut(noise, STRETCH)]
        return chances(left, (0.0, 18.4), accuracy)[0]

    assert chance_of_none(0.6, 0.0) < 0.01
    assert chance_of_none(0.6, 0.6) > 0.99
    # Well beyond the accuracy it is no error of the model.
    assert chance_of_none(3.0, 0.6) < 0.01


def test_what_fitted_numbers_cost_lowers_the_odds():
    same = left_by(np.random.default_rng(3), 0.0)
    assert chances([same, same], (1.0, 1.0)) == pytest.approx([0.5, 0.5])
    assert chances([same, same], (1.0, 2.0))[0] == pytest.approx(expit(1.0), abs=1e-6)
