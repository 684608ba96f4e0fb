# SPDX-License-Identifier: BSD-3-Clause
"""Probabilities of alternatives against what is known of errors and of fitted numbers."""

import numpy as np
import pytest
from scipy.special import expit

from piezo_identification.diagnosis.experiment_design.model_weights import (
    HeldOut,
    determined_numbers,
    probabilities_of,
)

STRETCH = np.repeat(np.arange(40), 250)


def left_by(random, wrong_by):
    return HeldOut(random.normal(size=STRETCH.size) + wrong_by, STRETCH)


def chances(left, determined=(0.0, 0.0)):
    return probabilities_of([[each] for each in left], determined, [0.0])


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
    everywhere = HeldOut(noise + 0.06 * sign, STRETCH)
    # The same sum of squares, but the rest of the stretches says a little less against it.
    once = HeldOut(noise + 0.06 * np.sqrt(40) * sign * (STRETCH == 7), STRETCH)
    assert chances([right, everywhere])[0] > 0.95
    assert chances([right, once])[0] < chances([right, everywhere])[0]


def test_a_fitted_number_costs_only_where_it_is_determined():
    random = np.random.default_rng(3)
    same = left_by(random, 0.0)
    equal = chances([same, same], (1.0, 1.0))
    assert equal == pytest.approx([0.5, 0.5])
    assert chances([same, same], (1.0, 2.0))[0] == pytest.approx(
        expit(0.5 * np.log(same.independent)), abs=1e-6)


def test_numbers_are_determined_as_far_as_recordings_tell_more_than_their_widths():
    information = np.diag([1e8, 1.0, 1e-8])
    assert determined_numbers(information, np.ones(3)) == pytest.approx(1.5, abs=1e-6)
    turned = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    assert determined_numbers(turned @ information @ turned.T, np.ones(3)) == pytest.approx(
        1.5, abs=1e-6)
    assert determined_numbers(information, np.array([1e-4, 1.0, 1e4])) == pytest.approx(1.5)
    assert determined_numbers(np.zeros((0, 0)), np.zeros(0)) == 0.0
