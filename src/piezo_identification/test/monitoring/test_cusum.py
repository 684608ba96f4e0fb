# SPDX-License-Identifier: BSD-3-Clause
"""Run lengths of the cumulative sums against Markov chains and drawn values."""

import numpy as np
import pytest
from scipy.stats import norm

from piezo_identification.monitoring.cusum import Cusum, run_length, threshold_of


def run_length_of_a_chain(threshold, allowance, shift, cells=400):
    """Brook and Evans, Biometrika 59, 1972: the sum as a Markov chain on a fine grid."""
    width = 2.0 * threshold / (2 * cells - 1)
    state = width * np.arange(cells)
    edges = state[None, :] - state[:, None] + allowance - shift
    inside = norm.cdf(edges + 0.5 * width) - norm.cdf(edges - 0.5 * width)
    inside[:, 0] = norm.cdf(edges[:, 0] + 0.5 * width)
    return np.linalg.solve(np.eye(cells) - inside, np.ones(cells))[0]


@pytest.mark.parametrize(("threshold", "allowance"), [(4.0, 0.5), (5.0, 0.5), (3.5, 0.9)])
@pytest.mark.parametrize("shift", [0.0, 1.0, 2.0])
def test_run_lengths_are_those_of_a_chain(threshold, allowance, shift):
    expected = run_length_of_a_chain(threshold, allowance, shift)
    assert run_length(threshold, allowance, shift) == pytest.approx(expected, rel=0.08)


def test_tabled_run_length():
    # Montgomery, Statistical Quality Control: h = 5, k = 1/2 gives 465 with both sides.
    assert 0.5 * run_length(5.0, 0.5) == pytest.approx(465.0, rel=0.02)


def alarms(values, test):
    return [(number, changed) for number, value in enumerate(values)
            if (changed := test.add(value))]


def test_false_alarms_come_as_rarely_as_stated():
    threshold = threshold_of(400.0, 0.5)
    count = 60_000
    raised = alarms(np.random.default_rng(1).normal(size=count), Cusum(threshold, 0.5))
    expected = count / 200.0  # both sides
    assert abs(len(raised) - expected) < 4.0 * np.sqrt(expected)


def test_a_change_is_found_in_the_time_expected_and_its_beginning_estimated():
    threshold, shift, before = threshold_of(1e5, 0.5), 1.0, 50
    delays, begins = [], []
    for seed in range(200):
        values = np.random.default_rng(seed).normal(size=300)
        values[before:] += shift
        raised = alarms(values, Cusum(threshold, 0.5))
        number, changed = next(found for found in raised if found[0] >= before)
        assert changed > 0
        delays.append(number + 1 - before)
        begins.append(number + 1 - changed)
    assert np.mean(delays) == pytest.approx(run_length(threshold, 0.5, shift), rel=0.1)
    assert abs(np.median(begins) - before) <= 3


def test_a_fall_is_told_from_a_rise():
    assert alarms(np.full(10, -2.0), Cusum(4.0, 0.5))[0] == (2, -3)


def test_no_threshold_for_alarms_all_the_time():
    with pytest.raises(ValueError, match="ask for fewer false alarms"):
        threshold_of(1.0, 0.5)
