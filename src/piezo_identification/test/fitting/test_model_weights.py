# SPDX-License-Identifier: BSD-3-Clause
"""Probabilities of alternatives against what is known of errors and of fitted numbers."""

import numpy as np
import pytest
from scipy.special import expit

from piezo_identification.fitting.model_weights import (
    HeldOut,
    expected_widths,
    occam_penalty,
    probabilities_of,
)
from piezo_models.effects import Extent
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.sensor_nonlinearity import SensorNonlinearity

STRETCH = np.repeat(np.arange(40), 250)


def left_by(random, wrong_by):
    return HeldOut(random.normal(size=STRETCH.size) + wrong_by, STRETCH)


def chances(left, penalties=(0.0, 0.0)):
    return probabilities_of([[each] for each in left], penalties, [0.0])


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


def test_an_effect_that_takes_up_an_error_within_the_accuracy_of_the_model_is_not_bought():
    """Many rows show an error that is alike in each stretch; it may look like any effect."""
    random = np.random.default_rng(5)
    noise, shape = random.normal(size=STRETCH.size), random.normal(size=40)[STRETCH]
    right = HeldOut(noise, STRETCH)

    def chance_of_none(error, accuracy):
        left = [[HeldOut(noise + error * shape, STRETCH)], [right]]
        return probabilities_of(left, (0.0, 18.4), [accuracy])[0]

    assert chance_of_none(0.3, 0.0) < 0.01
    assert chance_of_none(0.3, 0.5) > 0.99
    # Well beyond the accuracy it is no error of the model.
    assert chance_of_none(2.0, 0.5) < 0.01


def test_what_fitted_numbers_cost_lowers_the_odds():
    same = left_by(np.random.default_rng(3), 0.0)
    assert chances([same, same], (1.0, 1.0)) == pytest.approx([0.5, 0.5])
    assert chances([same, same], (1.0, 2.0))[0] == pytest.approx(expit(1.0), abs=1e-6)


def test_a_number_costs_as_much_as_recordings_narrow_it_and_nothing_where_they_do_not():
    # The evidence of a mean with a Gaussian prior, over that at its best value, in closed form.
    width, deviation, rows = 2.0, 0.1, 1000.0
    alone = occam_penalty(np.array([[deviation**2]]), np.array([width]), rows, rows)
    assert alone == pytest.approx(0.5 * np.log(1.0 + (width / deviation) ** 2))
    fewer = occam_penalty(np.array([[deviation**2 / 2.0]]), np.array([width]), 2.0 * rows, rows)
    assert fewer == pytest.approx(alone)
    unseen = np.diag([deviation**2, 1e12, 0.0])
    assert occam_penalty(unseen, np.full(3, width), rows, rows) == pytest.approx(alone)


def test_no_number_costs_more_than_with_a_prior_of_one_error():
    most = 0.5 * np.log(1000.0)
    assert occam_penalty(np.array([[1e-12]]), np.ones(1), 1000.0, 1000.0) == pytest.approx(most)
    assert occam_penalty(None, np.ones(2), 1000.0, 1000.0) == pytest.approx(2.0 * most)


def test_a_delay_and_a_lag_are_expected_alike():
    extent = Extent(10.0, 0.0, 100.0, 1.0, 1e-4)
    of_delay, of_lag = expected_widths([Delay(2e-4)], extent), expected_widths(
        [SensorLag(2e-4, 0.1)], extent)
    # As a logarithm, the number of one is that of the other over its size.
    assert of_delay[0] / 2e-4 == pytest.approx(of_lag[0])
    assert of_lag[1] == pytest.approx(0.5 / np.sqrt(12.0))
    curve = expected_widths([SensorNonlinearity(0.0, 0.2, 1e-5, 0.0, 5.0, 10.0)], extent)
    assert curve == pytest.approx(np.full(4, curve[1]))
