# SPDX-License-Identifier: BSD-3-Clause
"""False alarms and delays of the evidence on drawn blocks."""

import numpy as np
import pytest
from scipy.stats import t

from piezo_identification.monitoring.usual_error import (
    FACTORS,
    STRAY,
    STRAY_RANGE,
    ChangeEvidence,
    Expected,
)

EXPECTED = Expected(np.log(0.02), 0.25, 40.0)


def drawn(count, seed):
    """Logarithms of the errors of blocks of an unchanged stage, of which some stray."""
    random = np.random.default_rng(seed)
    usual = EXPECTED.middle + EXPECTED.scale * random.standard_t(EXPECTED.freedom, size=count)
    stray = EXPECTED.middle + STRAY_RANGE * random.uniform(-0.5, 0.5, size=count)
    return np.where(random.random(count) < STRAY, stray, usual)


def first_report(values, threshold):
    evidence = ChangeEvidence()
    return next(((number, change) for number, value in enumerate(values)
                 if (change := evidence.add(value, EXPECTED)).logarithm > threshold), None)


@pytest.mark.parametrize("draws", [15, pytest.param(40, marks=pytest.mark.long)])
def test_false_alarms_are_no_more_than_stated(draws):
    mean_run, counts = 200, []
    for seed in range(draws):
        found = first_report(drawn(4 * mean_run, seed), np.log(mean_run))
        counts.append(4 * mean_run if found is None else found[0] + 1)
    assert np.mean(counts) > mean_run


def test_a_doubled_error_is_found_within_ten_blocks_and_its_beginning_estimated():
    before, delays, begins = 50, [], []
    for seed in range(40):
        values = drawn(before + 60, seed)
        values[before:] += np.log(2.0)
        number, change = first_report(values, np.log(1e6))
        delays.append(number + 1 - before)
        begins.append(number + 1 - change.blocks)
    assert min(delays) > 0
    assert np.median(delays) <= 10
    assert abs(np.median(begins) - before) <= 2


def test_the_evidence_of_one_block_is_the_mean_of_the_ratios_of_its_densities():
    value, scale = EXPECTED.middle + 1.5, EXPECTED.scale
    growth = np.log(FACTORS)

    def density(middle, scale):
        return (1.0 - STRAY) * t.pdf(value, EXPECTED.freedom, middle, scale) + STRAY / STRAY_RANGE

    grown = density(EXPECTED.middle + growth, np.hypot(scale, 0.5 * (growth[1] - growth[0])))
    assert ChangeEvidence().add(value, EXPECTED).logarithm == pytest.approx(
        np.log(np.mean(grown / density(EXPECTED.middle, scale))), rel=1e-9)


def test_one_block_shows_no_change():
    values = np.full(20, EXPECTED.middle)
    values[10] += np.log(1e3)
    assert first_report(values, np.log(1e4)) is None


def test_a_smaller_error_is_no_change():
    assert first_report(np.full(100, EXPECTED.middle - np.log(1.5)), 0.0) is None


def test_the_factor_is_that_of_the_growth():
    values = np.full(30, EXPECTED.middle + np.log(8.0))
    _, change = first_report(values, np.log(1e6))
    assert change.factor == pytest.approx(8.0, rel=0.3)
