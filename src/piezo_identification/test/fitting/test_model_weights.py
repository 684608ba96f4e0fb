# SPDX-License-Identifier: BSD-3-Clause
"""What fitted numbers cost against what is known in closed form."""

import numpy as np
import pytest

from piezo_identification.fitting.model_weights import expected_widths, occam_penalty
from piezo_models.effects import Extent
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.sensor_nonlinearity import SensorNonlinearity


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
