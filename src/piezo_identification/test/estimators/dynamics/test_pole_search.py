# SPDX-License-Identifier: BSD-3-Clause
"""A search in rows far between looks at the frequencies of the whole record."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

from piezo_identification.estimators.dynamics.fast_record import FastRecord
from piezo_identification.estimators.dynamics.pole_search import free_fits, residual_peaks
from piezo_identification.estimators.poles.pole_responses import HeldInput

PERIOD_S, COUNT, MODE_RAD_PER_S = 1e-4, 12_000, 4660.0


def record():
    """A mode that answers noise, in every row."""
    inputs = np.random.default_rng(2).normal(size=COUNT // 4).repeat(4)
    w, damping = MODE_RAD_PER_S, 0.01
    system = cont2discrete(([w * w], [1.0, 2.0 * damping * w, w * w]), PERIOD_S)
    output = dlsim((*system[:2], PERIOD_S), inputs)[1][:, 0]
    rows = np.arange(COUNT - 2)
    return FastRecord(HeldInput(inputs, PERIOD_S, False), rows, output[rows],
                      np.ones((rows.size, 1)), lambda modes: [])


@pytest.mark.parametrize("most_rows", [COUNT, 2000])
def test_what_is_left_peaks_at_the_mode_however_few_rows_are_fitted(most_rows):
    thinned = record().thinned(most_rows)
    lag_alone = thinned.free(np.log([PERIOD_S]), 0.0)
    # The rows of every sixth sample show no frequency above 833 Hz / 2, this one at 742 Hz.
    assert np.allclose(residual_peaks(thinned, lag_alone), MODE_RAD_PER_S, rtol=0.05)


def test_the_poles_of_a_record_are_sought_once_and_as_if_for_the_first_time():
    asked_twice, asked_once = record(), record()
    first = list(free_fits(asked_twice.thinned(500), 0))
    again = list(free_fits(asked_twice.thinned(500), 1))
    assert again[0] is first[0]
    for found, fresh in zip(again, free_fits(asked_once.thinned(500), 1), strict=True):
        np.testing.assert_array_equal(found.vector, fresh.vector)
    assert np.exp(again[1].vector[1]) == pytest.approx(MODE_RAD_PER_S, rel=1e-3)
