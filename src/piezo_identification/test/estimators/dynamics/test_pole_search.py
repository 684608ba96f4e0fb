# SPDX-License-Identifier: BSD-3-Clause
"""Poles are found without a start, in all rows of a record or in few of them."""

from functools import cache

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

from piezo_identification.estimators.dynamics.fast_dynamics import ModeOrder
from piezo_identification.estimators.dynamics.fast_record import FastFit, FastRecord
from piezo_identification.estimators.dynamics.pole_search import free_fits
from piezo_identification.estimators.poles.pole_responses import HeldInput

PERIOD_S, COUNT, MODE_RAD_PER_S = 1e-4, 12_000, 4660.0


@cache
def signals():
    """Noise, and the mode that answers it."""
    inputs = np.random.default_rng(2).normal(size=COUNT // 4).repeat(4)
    w, damping = MODE_RAD_PER_S, 0.01
    system = cont2discrete(([w * w], [1.0, 2.0 * damping * w, w * w]), PERIOD_S)
    return inputs, dlsim((*system[:2], PERIOD_S), inputs)[1][:, 0]


def record():
    inputs, output = signals()
    rows = np.arange(COUNT - 2)
    return FastRecord(HeldInput(inputs, PERIOD_S, False), rows, output[rows],
                      np.ones((rows.size, 1)))


@pytest.mark.long
@pytest.mark.parametrize("most_rows", [COUNT, 2000])
def test_a_mode_is_found_however_few_rows_are_fitted(most_rows):
    """The rows of every sixth sample show no frequency above 833 Hz / 2, this one at 742 Hz."""
    fits = list(free_fits(record().thinned(most_rows), 8))
    assert np.exp(fits[1].vector[1:]) == pytest.approx([MODE_RAD_PER_S, 0.01], rel=1e-3)
    assert all(more.cost <= 1.01 * fewer.cost for fewer, more in zip(fits, fits[1:], strict=False))


def test_the_poles_of_a_record_are_sought_once_and_as_if_for_the_first_time():
    asked_twice, asked_once = record(), record()
    first = list(free_fits(asked_twice.thinned(200), 0))
    again = list(free_fits(asked_twice.thinned(200), 1))
    assert again[0] is first[0]
    for found, fresh in zip(again, free_fits(asked_once.thinned(200), 1), strict=True):
        np.testing.assert_array_equal(found.vector, fresh.vector)
    assert np.exp(again[1].vector[1]) == pytest.approx(MODE_RAD_PER_S, rel=1e-3)


@pytest.mark.parametrize("lag_s, mode_rad_per_s, beside_rad_per_s, part", [
    (1e-3, MODE_RAD_PER_S, MODE_RAD_PER_S, ""),
    (PERIOD_S * COUNT, MODE_RAD_PER_S, MODE_RAD_PER_S, "a lag as long as the record"),
    (1e-3, 0.9 * 2.0 * np.pi / (PERIOD_S * COUNT), MODE_RAD_PER_S, "a mode whose period is longer"),
    (1e-3, MODE_RAD_PER_S, 0.9 * 2.0 * np.pi / (PERIOD_S * COUNT), "a mode whose period is longer"),
    (1e-3, MODE_RAD_PER_S, 1.1 * 2.0 * np.pi / (PERIOD_S * COUNT), ""),
    (1e-3, 1.1 * np.pi / PERIOD_S, MODE_RAD_PER_S, "a mode that rings faster")])
def test_parts_that_a_record_cannot_show_are_named(
        lag_s, mode_rad_per_s, beside_rad_per_s, part):
    vector = np.append(np.log([lag_s, mode_rad_per_s, 0.01, beside_rad_per_s, 0.3]), 0.3)
    fit = FastFit(ModeOrder(1, 0, 1), vector, 0.0, np.zeros(1), np.zeros((1, 1)))
    assert record().beyond_record(fit).startswith(part)
    assert bool(record().beyond_record(fit)) == bool(part)
