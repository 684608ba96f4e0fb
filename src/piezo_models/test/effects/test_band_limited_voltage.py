# SPDX-License-Identifier: BSD-3-Clause
"""A voltage that is smooth between its rows, beside tones that are known between them."""

import numpy as np
import pytest

from piezo_models.effects.band_limited_voltage import means_of_parts

PERIOD_S, ROWS = 1e-3, 1500
RATES = 2.0 * np.pi / PERIOD_S * np.linspace(0.013, 0.37, 25)
PHASES = np.random.default_rng(5).uniform(0.0, 2.0 * np.pi, RATES.size)


def wave(time_s, of_each=1.0):
    """Tones up to 0.37 of the rate of the rows, each with a complex factor."""
    return np.real(np.exp(1j * (np.multiply.outer(time_s, RATES) + PHASES)) @ (
        of_each * np.ones(RATES.size)))


def test_the_means_over_parts_of_a_row_are_those_of_the_tones():
    parts = 8
    begin_s = PERIOD_S / parts * np.arange(ROWS * parts)
    step = 1j * RATES * PERIOD_S / parts
    wanted_v = wave(begin_s, np.expm1(step) / step)
    found_v = means_of_parts(wave(PERIOD_S * np.arange(ROWS)), parts)
    inside = slice(300 * parts, -300 * parts)
    assert np.std((found_v - wanted_v)[inside]) < 1e-3 * np.std(wanted_v)


@pytest.mark.parametrize("rows", [1, 2, 7, 500])
def test_a_voltage_that_stays_stays_between_its_rows(rows):
    np.testing.assert_allclose(means_of_parts(np.full(rows, 3.0), 4), 3.0, atol=1e-12)
