# SPDX-License-Identifier: BSD-3-Clause
"""The smoothing that is chosen, beside the best there is, on a hysteresis of plays."""

import threading
from itertools import count

import numpy as np
import pytest

from piezo_common import side_by_side
from piezo_common.budget import Budget, spending
from piezo_identification.estimators.hysteresis.equations import Equations, HysteresisSegment
from piezo_identification.estimators.hysteresis.smoothed_density import (
    smoothed_density,
)
from piezo_identification.estimators.hysteresis.smoothing_choice import (
    FURTHER_WEIGHTS,
    USUAL,
    choose_penalties,
)

RADII_V = np.linspace(0.0, 90.0, 181)
WEIGHTS_UM_PER_V = np.append(0.3, 0.4 * np.diff(1.0 - np.exp(-((RADII_V / 30.0) ** 1.3))))
NOISE_UM = 0.005


def plays(voltage_v):
    """Output of play operators, which come down from far above: no grid of relays is theirs."""
    state, output_um = voltage_v[0] + RADII_V, np.empty(voltage_v.size)
    for n, v in enumerate(voltage_v):
        state = np.maximum(v - RADII_V, np.minimum(v + RADII_V, state))
        output_um[n] = WEIGHTS_UM_PER_V @ state
    return output_um


def triangles(tops_v, samples):
    return np.append(np.interp(
        np.arange(0.0, 2.0 * len(tops_v), 2.0 / samples), np.arange(2 * len(tops_v) + 1),
        np.ravel([[0.0, top] for top in tops_v] + [[0.0, 0.0]])[:-1]), 0.0)


LEVELS = 32
VOLTAGE_V = triangles(100.0 / LEVELS * np.arange(1, LEVELS + 1), 120)
LEVELS_V = np.linspace(0.0, 100.0, 2 * LEVELS + 1)
UNSEEN_V = triangles([100.0, 63.0, 87.0, 31.0, 74.0, 12.0, 55.0], 300)


@pytest.fixture(scope="module")
def measured_um():
    noise_um = np.random.default_rng(1).normal(scale=NOISE_UM, size=VOLTAGE_V.size)
    return plays(VOLTAGE_V) + noise_um


@pytest.fixture(scope="module")
def error_of():
    truth_um = plays(UNSEEN_V)

    def error_of(estimate):
        return np.std(estimate.model().simulate(UNSEEN_V) - truth_um)

    return error_of


def estimate_of(output_um, **options):
    return smoothed_density(VOLTAGE_V, output_um, LEVELS_V, level_count=LEVELS, **options)


def test_the_chosen_smoothing_predicts_about_as_well_as_the_best(measured_um, error_of):
    chosen = estimate_of(measured_um)
    errors = [error_of(estimate_of(measured_um, smoothing_weight=10.0**-power))
              for power in (11, 14)]
    assert error_of(chosen) < 1.2 * min(errors)
    # The choice matters.
    assert max(errors) > 1.3 * min(errors)


def test_without_time_to_choose_the_smoothing_is_the_usual_one(measured_um, error_of):
    budget = Budget(1.0, count().__next__)
    with spending(budget):
        found = estimate_of(measured_um)
    assert (found.smoothing_weight, 2 * len(found.density_um_per_v2)) == (USUAL, LEVELS_V.size - 1)
    assert {FURTHER_WEIGHTS, "a density about a sum of plays"} <= set(budget.not_tried)
    assert error_of(found) < NOISE_UM


@pytest.mark.long
def test_a_transient_that_lies_in_one_part_does_not_decide_the_smoothing(measured_um, error_of):
    # The start decays within the first branches; what is left of it elsewhere is rounding.
    decay = np.exp(-np.outer(np.arange(VOLTAGE_V.size), [1.0 / 40.0, 1.0 / 900.0]))
    with_start = estimate_of(measured_um + decay @ [0.5, -0.2], transients=decay)
    assert error_of(with_start) < 1.2 * error_of(estimate_of(measured_um))


def test_folds_are_fitted_side_by_side_and_choose_the_same(measured_um, monkeypatch):
    size = VOLTAGE_V.size
    segment = HysteresisSegment(VOLTAGE_V, measured_um, np.arange(size), np.empty((size, 0)))
    solve, threads, choices = Equations.solve, [], []

    def noted(*arguments, **options):
        threads[-1].add(threading.get_ident())
        return solve(*arguments, **options)

    monkeypatch.setattr(Equations, "solve", noted)
    for cores in (1, 2):
        threads.append(set())
        monkeypatch.setattr(side_by_side, "cores", lambda cores=cores: cores)
        choices.append(choose_penalties([segment], np.linspace(0.0, 100.0, 9)))
    own = {threading.get_ident()}
    assert threads[0] == own and threads[1] > own
    assert choices[0].penalties == choices[1].penalties
    np.testing.assert_array_equal(choices[0].forces, choices[1].forces)
