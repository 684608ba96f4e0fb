# SPDX-License-Identifier: BSD-3-Clause
"""Regressions on voltages whose swings decay by so little that thousands are remembered."""

import numpy as np
import pytest

from piezo_identification.estimators.hysteresis.everett_regression import (
    everett_regression,
    histories,
    remembered_pairs,
)
from piezo_models.hysteresis.preisach import PreisachModel

SWINGS, CELLS = 1500, 20
LEVELS_V = np.linspace(0.0, 100.0, CELLS + 1)


def remembered_v():
    """All of these voltages are remembered until the end."""
    sizes_v = 20.0 * (1.0 - np.arange(SWINGS) / SWINGS)
    return np.concatenate([[0.0, 100.0], 40.0 + sizes_v * (-1.0) ** np.arange(SWINGS)])


def test_a_row_has_one_entry_for_each_unknown_and_gives_the_output_of_the_model():
    voltage_v = remembered_v()
    density = np.tril(np.random.default_rng(0).uniform(size=(CELLS, CELLS)))
    model = PreisachModel(0.0, 100.0, density)
    regression = everett_regression(voltage_v, LEVELS_V)
    shares = 25.0 * (np.tril(density, -1) + np.diag(0.5 * np.diagonal(density)))
    rows = np.cumsum(shares[:, ::-1], axis=1)[:, ::-1]
    unknowns = np.append(np.cumsum(rows, axis=0)[np.tril_indices(CELLS)], np.zeros(CELLS))
    output_um = regression.output_um(unknowns)
    assert output_um == pytest.approx(model.simulate(voltage_v), rel=1e-9)
    assert output_um == pytest.approx(regression.matrix @ unknowns, rel=1e-12)
    for rows in (regression.branches, regression.moving):
        assert np.diff(rows.indptr).max() <= unknowns.size
        before = rows.nnz
        rows.sum_duplicates()
        assert rows.nnz == before


def test_few_pairs_of_remembered_voltages_give_nearly_the_same_output():
    voltage_v = remembered_v()
    samples = np.arange(voltage_v.size)
    pairs, history = remembered_pairs(voltage_v, LEVELS_V, samples)
    # Rounded to 0.01 V, nearly all of them still differ.
    in_last_row = pairs[pairs[:, 0] == samples[-1]]
    assert len(in_last_row) == pytest.approx(SWINGS, rel=0.01)
    assert (history == histories(voltage_v, LEVELS_V, samples)).all()

    fine_v = np.concatenate([voltage_v[:2], 40.0 + 0.01 * (voltage_v[2:] - 40.0)])
    pairs, _ = remembered_pairs(fine_v, LEVELS_V, samples)
    assert np.count_nonzero(pairs[:, 0] == samples[-1]) < 50
    # A play of zero width follows the voltage; one of a tenth of the swings in between.
    ways, sign = pairs[:, 1] - pairs[:, 2], pairs[:, 3]
    for width in (0.0, 4e-4):
        expected = -1.0 + np.zeros(samples.size)
        scaled = fine_v / 50.0 - 1.0
        for n in range(1, samples.size):
            expected[n] = min(max(expected[n - 1], scaled[n] - width), scaled[n])
        output = np.bincount(pairs[:, 0].astype(int), sign * np.maximum(ways - width, 0.0),
                             samples.size) - 1.0
        assert output == pytest.approx(expected, abs=1e-4)
