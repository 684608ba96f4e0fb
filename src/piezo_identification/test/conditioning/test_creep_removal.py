# SPDX-License-Identifier: BSD-3-Clause
"""Creep is taken out of rows of any length, in which it goes on while the voltage is held."""

import numpy as np
import pytest

from piezo_identification.conditioning.creep_removal import remove_creep, remove_creep_of_held
from piezo_models.linear.dynamics import CreepDynamics

CREEP = CreepDynamics((0.02, 0.4, 7.0, 300.0), (0.0203, 0.404, 7.1, 303.0))
LEVELS = np.array([20.0, 80.0, 60.0, 20.0, 50.0, 90.0])
ROWS = 5


def gains(creep):
    """Parts of the exponentials, from the partial fractions."""
    poles, zeros = np.array(creep.poles_rad_per_s), np.array(creep.zeros_rad_per_s)
    return [np.prod(zeros - pole) / np.prod(np.delete(poles, i) - pole) / pole
            for i, pole in enumerate(poles)]


def crept(period_s):
    """Displacements at the end of each row of levels that are held, in closed form."""
    end_s = (np.arange(LEVELS.size * ROWS) + 1) * period_s
    changes = np.diff(LEVELS, prepend=0.0)
    begins_s = np.arange(LEVELS.size) * ROWS * period_s
    begins_s[0] = -np.inf
    total = np.repeat(LEVELS, ROWS).astype(float)
    for rate, gain in zip(CREEP.poles_rad_per_s, gains(CREEP), strict=True):
        since_s = np.maximum(end_s[:, None] - begins_s, 0.0)
        total -= gain * np.expm1(-rate * since_s) @ changes
    return total


@pytest.mark.parametrize("period_s", [1e-3, 0.05, 1.0])
def test_what_was_held_is_found_again(period_s):
    held = remove_creep_of_held(crept(period_s), CREEP, period_s)
    np.testing.assert_allclose(held, np.repeat(LEVELS, ROWS), rtol=1e-9)


def test_without_creep_a_signal_stays_as_it_is():
    np.testing.assert_array_equal(remove_creep_of_held(LEVELS, CreepDynamics(), 1.0), LEVELS)


def test_what_moves_between_short_rows_is_found_by_either_rule():
    signal = np.sin(np.arange(2000) * 1e-3)
    np.testing.assert_allclose(
        remove_creep(signal, CREEP, 1e-3), remove_creep_of_held(signal, CREEP, 1e-3), atol=1e-4)


@pytest.mark.parametrize(("poles", "zeros"), [
    pytest.param((1.0,), (0.9,), id="an exponential that goes backwards"),
    pytest.param((1.0, 1.0), (1.1, 1.2), id="two poles that are equal")])
def test_creep_that_is_no_sum_of_positive_exponentials_is_taken_out_between_rows(poles, zeros):
    creep = CreepDynamics(poles, zeros)
    np.testing.assert_array_equal(
        remove_creep_of_held(LEVELS, creep, 0.1), remove_creep(LEVELS, creep, 0.1))
