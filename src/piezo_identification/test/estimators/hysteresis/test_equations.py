# SPDX-License-Identifier: BSD-3-Clause
"""Normal equations by branches beside those of the rows of the regression."""

import numpy as np
import pytest

from piezo_identification.estimators.hysteresis.density_fit import _thinned
from piezo_identification.estimators.hysteresis.equations import Equations, HysteresisSegment
from piezo_identification.estimators.hysteresis.everett_regression import everett_regression

SIZE, SAMPLES = 12, 3000


def walk_v():
    """A voltage that often leaves the range that it has been in, and reverses in most rows."""
    return np.cumsum(np.random.default_rng(1).normal(size=SAMPLES))


def decaying_v():
    """Swings that decay: most remembered extremes are those of earlier ones."""
    rows = np.arange(SAMPLES)
    return 50.0 - 50.0 * np.cos(2.0 * np.pi * rows / 100.0) * np.exp(-rows / 1000.0)


@pytest.mark.parametrize("voltage_v", [walk_v(), decaying_v()])
@pytest.mark.parametrize("share", [1.0, 0.5])
def test_equations_of_branches_are_those_of_their_rows(voltage_v, share):
    random = np.random.default_rng(2)
    chosen = random.random(SAMPLES) < share
    levels_v = np.linspace(voltage_v.min(), voltage_v.max(), SIZE + 1)
    rows = everett_regression(voltage_v, levels_v).select(chosen)
    output, others = random.normal(size=chosen.sum()), random.normal(size=(chosen.sum(), 2))
    equations = Equations(SIZE, 2)
    equations.add(rows, others, output)
    matrix = rows.matrix.toarray()
    scale = np.abs(matrix.T @ matrix).max()
    assert equations.quadratic.toarray() == pytest.approx(matrix.T @ matrix, abs=1e-12 * scale)
    assert equations.linear == pytest.approx(matrix.T @ output, abs=1e-11 * scale)
    assert equations.border == pytest.approx(matrix.T @ others, abs=1e-11 * scale)
    assert equations.count == output.size


def test_a_weight_counts_rows_several_times():
    levels_v = np.linspace(0.0, 100.0, SIZE + 1)
    rows = everett_regression(decaying_v(), levels_v)
    output, others = np.random.default_rng(3).normal(size=(2, SAMPLES))
    weighed, twice = Equations(SIZE, 1), Equations(SIZE, 1)
    weighed.add(rows, others[:, None], output, weight=2.0)
    for _ in range(2):
        twice.add(rows, others[:, None], output)
    assert (weighed.count, twice.count) == (SAMPLES, 2 * SAMPLES)
    for name in "linear", "border", "corner", "border_linear", "square":
        assert getattr(weighed, name) == pytest.approx(getattr(twice, name))
    assert abs(weighed.quadratic - twice.quadratic).max() < 1e-9 * abs(twice.quadratic).max()


@pytest.mark.parametrize("sizes, kept", [
    ([50, 30], [50, 30]), ([50, 10000], [50, 50]), ([400, 400], [50, 50]),
    ([7, 60, 2000], [7, 30, 47])])
def test_long_segments_are_thinned_to_the_rows_that_short_ones_leave(sizes, kept):
    segments = [HysteresisSegment(np.zeros(size), np.zeros(size), np.arange(size),
                                  np.empty((size, 0)), weight=number + 1.0)
                for number, size in enumerate(sizes)]
    thinned = _thinned(segments, 100)
    assert [each.samples.size for each in thinned] == kept
    assert sum(kept) <= 100
    before, after = (np.array([each.weight * each.samples.size for each in chosen])
                     for chosen in (segments, thinned))
    assert after.sum() == pytest.approx(sum(kept))
    assert after / after[0] == pytest.approx(before / before[0], rel=0.05)
