# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_models.hysteresis.preisach import PreisachModel
from piezo_studies.baselines.relay_grid import (
    activation_matrix,
    cell_centre_relays,
    simulate_relays,
)


def test_areas_are_those_counted_with_many_small_relays():
    levels = np.array([-1.0, 0.0, 1.0, 2.0, 3.0])
    fine = np.linspace(-1, 3, 4 * 64 + 1)
    i, j = np.tril_indices(256)
    centres = (fine[:-1] + fine[1:]) / 2
    small_areas = np.where(i == j, 0.5, 1.0) / 64**2
    voltage = np.random.default_rng(0).uniform(-1.3, 3.3, 12)
    areas = activation_matrix(voltage, levels)
    rows, columns = np.tril_indices(4)
    for cell in range(10):
        inside = (i // 64 == rows[cell]) & (j // 64 == columns[cell])
        counted = simulate_relays(voltage, centres[i], centres[j], small_areas * inside)
        np.testing.assert_allclose(areas[:, cell], counted, atol=0.02)


def test_saturation_covers_every_cell():
    levels = np.linspace(-20, 120, 51)
    areas = activation_matrix([200.0, -200.0], levels)
    i, j = np.tril_indices(50)
    np.testing.assert_allclose(areas[0], np.where(i == j, 0.5, 1.0) * 2.8**2, rtol=1e-12)
    assert not areas[1].any()


def test_staircase_through_a_cell_leaves_the_exact_fraction():
    areas = activation_matrix([1.6, 0.3], [0.0, 1.0, 2.0])
    # Cells (0, 0), (1, 0), (1, 1), first rising to 1.6 V, then falling to 0.3 V.
    np.testing.assert_allclose(areas[0], [0.5, 0.6, 0.6**2 / 2], atol=1e-15)
    np.testing.assert_allclose(areas[1], [0.5 - 0.7**2 / 2, 0.3 * 0.6, 0.0], atol=1e-15)


def test_chosen_samples_are_rows_of_the_whole():
    voltage = np.random.default_rng(1).uniform(0, 5, 200)
    levels = np.linspace(0, 5, 11)
    chosen = np.array([0, 3, 50, 199])
    whole = activation_matrix(voltage, levels)
    assert np.array_equal(activation_matrix(voltage, levels, chosen), whole[chosen])


def test_amplitude_stair_identifies_every_cell():
    levels = np.linspace(0, 5, 11)
    stair = np.concatenate([np.r_[levels[: k + 1], levels[k::-1]] for k in range(1, 11)])
    assert np.linalg.matrix_rank(activation_matrix(stair, levels)) == 55


@pytest.mark.parametrize(
    "arguments",
    [
        ([0.0], [1.0, 0.0]),
        ([0.0], [1.0]),
        ([np.nan], [0.0, 1.0]),
        ([0.0, 1.0], [0.0, 1.0], [1, 0]),
        ([0.0, 1.0], [0.0, 1.0], [2]),
    ],
)
def test_senseless_arguments_are_refused(arguments):
    with pytest.raises(ValueError):
        activation_matrix(*arguments)


def test_cell_centre_relays_carry_the_weight_of_the_density():
    model = PreisachModel(0.0, 4.0, np.array([[1.0, 0.0], [2.0, 3.0]]), 5.0)
    alpha, beta, weight = cell_centre_relays(model)
    assert alpha.tolist() == [1.0, 3.0, 3.0]
    assert beta.tolist() == [1.0, 1.0, 3.0]
    assert weight.tolist() == [2.0, 8.0, 6.0]
    output = simulate_relays([0.5, 3.5, 2.0, 0.5], alpha, beta, weight, 5.0)
    assert output.tolist() == [5.0, 21.0, 15.0, 5.0]
