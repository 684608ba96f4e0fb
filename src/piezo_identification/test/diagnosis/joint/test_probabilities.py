# SPDX-License-Identifier: BSD-3-Clause
"""Probabilities of alternatives against what Gaussian errors of known variance say."""

import numpy as np
import pytest

from piezo_identification.diagnosis.joint.probabilities import (
    ONE_CAUSE,
    SETTINGS,
    Evidence,
    ExpectedErrors,
    listed_probabilities,
    probabilities,
)
from piezo_identification.fitting.joint_fit import correlated_scale
from piezo_identification.fitting.model_weights import HeldOut

NOISE_UM = 0.01
STRETCH = np.repeat(np.arange(40), 25)


def expected(wrong_um=0.0, accuracy_um=0.0, noise_um=NOISE_UM):
    accuracy_um = np.array([accuracy_um])
    return ExpectedErrors(np.array([noise_um]), np.hypot(accuracy_um, wrong_um), accuracy_um)


def evidence(label, left_um, penalty, samples=1000):
    """Leave the same of every stretch, of which a bootstrap then draws no other ratio."""
    signs = np.random.default_rng(4).permutation(np.resize([1.0, -1.0], samples))
    return Evidence(label, (HeldOut(left_um * signs, np.arange(samples) * 40 // samples),), penalty)


def shares(*alternatives, samples=1000, **errors):
    return probabilities([evidence(*each, samples) for each in alternatives], expected(**errors), 1)


def test_they_sum_to_one_and_the_largest_comes_first():
    found = shares(("none", 0.02, 0), ("delay", 0.01, 1), ("creep", 0.0105, 3))
    assert sum(found.values()) == pytest.approx(1.0)
    assert list(found) == sorted(found, key=found.get, reverse=True)
    assert next(iter(found)) == "delay"
    assert found["none"] < 1e-6


def test_what_explains_nothing_is_less_probable_by_its_prior_and_what_its_numbers_cost():
    found = shares(("none", 0.01, 0.0), ("delay", 0.01, 3.0), ("creep+delay", 0.01, 3.0))
    assert found["none"] / found["delay"] == pytest.approx(np.exp(3.0) / ONE_CAUSE)
    assert found["delay"] / found["creep+delay"] == pytest.approx(1.0 / ONE_CAUSE)


def test_an_alternative_in_two_ways_has_the_probability_of_both():
    found = shares(("delay", 0.01, 0), ("creep", 0.01, 0), ("creep", 0.01, 0))
    assert found["creep"] == pytest.approx(2.0 * found["delay"])


def test_fewer_independent_samples_tell_less():
    alternatives = ("none", 0.0115, 0.0), ("delay", 0.01, 2.0)
    many, few = (shares(*alternatives, samples=number)["delay"] for number in (920, 40))
    assert many > 0.9 > 0.5 > few


@pytest.mark.parametrize(("beside", "is_named"), [
    (0.5, False),  # as a model may be wrong by
    (1.0, False),
    (5.0, True),
])
def test_what_a_model_may_be_wrong_by_names_no_effect_beside_another(beside, is_named):
    """The second one explains so many times what the model is known to be wrong by."""
    wrong_um = NOISE_UM
    left_um = np.hypot(NOISE_UM, beside * wrong_um)
    found = shares(("none", 10.0 * left_um, 0.0), ("delay", left_um, 1.0),
                   ("backlash+delay", NOISE_UM, 2.0), wrong_um=wrong_um)
    assert (found["backlash+delay"] > found["delay"]) is is_named
    assert found["none"] < 0.01


@pytest.mark.parametrize(("left", "is_believed"), [(1.0, False), (1.15, False), (1.5, True)])
def test_something_else_is_believed_where_more_is_left_than_passes_for_noise(left, is_believed):
    found = shares(("none", 0.04, 0), ("delay", left * NOISE_UM, 1))
    assert (found["something_else"] > 0.5) is is_believed


def test_a_share_of_a_large_error_does_not_pass_for_noise():
    # 489 nm beside 9 nm of noise were once explained, as they are little of 4369 nm.
    found = shares(("none", 4.369, 0), ("vibration_mode", 0.489, 3), samples=40, noise_um=0.009)
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
    found = shares(("none", left_um, 0), wrong_um=wrong_um, accuracy_um=1e-4, noise_um=noise_um)
    assert (found["something_else"] > 0.5) is is_believed


def test_the_probability_of_something_else_rises_steadily_beyond_what_is_declared():
    # The figures of docs/diagnosis_method.md.
    wrong_um = 0.003
    found = [shares(("none", np.hypot(0.002, times * wrong_um), 0), wrong_um=wrong_um,
                    noise_um=0.002)["something_else"] for times in (1.0, 2.0, 4.0, 6.0)]
    assert found == pytest.approx([0.05, 0.15, 0.68, 0.94], abs=0.01)


def chances(left, **errors):
    alternatives = [Evidence("none", (each,), 0.0) for each in left]
    return listed_probabilities(alternatives, expected(noise_um=1.0, **errors))


def test_with_white_noise_the_ratio_is_that_of_the_likelihoods():
    """Without errors of the model, and the noise known as far as it is."""
    random = np.random.default_rng(1)
    noise = random.normal(size=STRETCH.size)
    difference = 0.15 * np.sign(random.normal(size=STRETCH.size))
    left = [HeldOut(1.1 * noise, STRETCH), HeldOut(1.1 * noise + difference, STRETCH)]
    squares = [each.mean_square_um2 for each in left]
    count = max(each.independent for each in left)
    per_error = 1.0 / count + SETTINGS.noise_known / SETTINGS.independent
    exact = 0.5 * (squares[1] - squares[0]) / per_error
    found, other = chances(left)
    # The bootstrap is never surer than the likelihoods, and of little evidence nearly as sure.
    assert 0.5 * exact < np.log(found / other) <= 1.05 * exact


def test_one_stretch_that_speaks_for_an_alternative_is_less_than_all_of_them():
    random = np.random.default_rng(2)
    noise = 1.1 * random.normal(size=STRETCH.size)
    right = HeldOut(noise, STRETCH)
    sign = np.sign(random.normal(size=STRETCH.size))
    everywhere = HeldOut(noise + 0.4 * sign, STRETCH)
    # The same sum of squares, but the rest of the stretches says a little less against it.
    once = HeldOut(noise + 0.4 * np.sqrt(40) * sign * (STRETCH == 7), STRETCH)
    assert chances([right, everywhere])[0] > 0.95
    assert chances([right, once])[0] < chances([right, everywhere])[0]


@pytest.mark.parametrize(("error", "accuracy", "is_none"), [
    (1.0, 0.0, False), (0.6, 0.6, True), (3.0, 0.6, False)])
def test_an_effect_that_takes_up_an_error_within_the_accuracy_of_the_model_is_not_bought(
        error, accuracy, is_none):
    """Many rows show an error that is alike in each stretch; it may look like any effect."""
    random = np.random.default_rng(5)
    noise, shape = random.normal(size=STRETCH.size), random.normal(size=40)[STRETCH]
    alternatives = [Evidence("none", (HeldOut(noise + error * shape, STRETCH),), 0.0),
                    Evidence("delay", (HeldOut(noise, STRETCH),), 3.0)]
    found = listed_probabilities(alternatives, expected(noise_um=1.0, accuracy_um=accuracy))
    assert bool(found[0] > 0.9) is is_none
