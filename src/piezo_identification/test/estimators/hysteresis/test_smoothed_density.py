# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.sparse import csr_array

from piezo_identification.estimators.hysteresis.density_estimate import lower_triangle
from piezo_identification.estimators.hysteresis.everett_regression import (
    density_operator,
    everett_regression,
    visited_cells,
)
from piezo_identification.estimators.hysteresis.nonnegative import nonnegative_minimum
from piezo_identification.estimators.hysteresis.penalties import curvature_operator
from piezo_identification.estimators.hysteresis.smoothed_density import smoothed_density
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_studies.baselines.relay_grid import activation_matrix

NOISE_UM = 0.009


def reversal_curves(lowest_v, highest_v, count, samples=400):
    rise = 0.5 * (1.0 - np.cos(2.0 * np.pi * np.arange(samples) / samples))
    tops_v = np.linspace(lowest_v, highest_v, count + 1)[1:]
    return np.append(lowest_v + np.outer(tops_v - lowest_v, rise).ravel(), lowest_v)


def truth(lowest_v=-20.0, highest_v=120.0, floor=0.002, cells=1000):
    """Ridge that decays with alpha - beta, and a bump with ripples: no sum f(alpha) + g(beta)."""
    width_v = (highest_v - lowest_v) / cells
    alpha, beta = lowest_v + (np.indices((cells, cells)) + 0.5) * width_v
    bump = np.exp(-(((alpha - 0.7 * highest_v) / 30) ** 2 + ((beta - 0.3 * highest_v) / 25) ** 2))
    density = floor + 0.03 * np.exp(-(alpha - beta) / 18)
    density += 0.005 * bump * (1 + 0.3 * np.sin(alpha / 15))
    return PreisachModel(lowest_v, highest_v, np.tril(np.maximum(density, 0.0)), -9.0)


def unseen_voltage_v(lowest_v, highest_v):
    turns = [0, 0.836, 0.236, 0.747, 0.305, 0.652, 0.415, 0.933, 0.09, 0.585, 0.207, 0.5]
    steps = np.interp(np.arange(0.0, 11.0, 2e-3), np.arange(12), turns)
    return lowest_v + (highest_v - lowest_v) * steps


def unknowns_of(density, reversible):
    """Unknowns of the regression from what they determine: integrals over cells and diagonal."""
    shares = np.tril(density, -1) + np.diag(0.5 * np.diagonal(density) + reversible)
    rows = np.cumsum(shares[:, ::-1], axis=1)[:, ::-1]
    return np.append(np.cumsum(rows, axis=0)[np.tril_indices(len(density))], reversible)


def random_density(size, rng):
    return np.tril(rng.uniform(size=(size, size)))


@pytest.mark.parametrize("seed", [
    0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 5))])
def test_everett_rows_and_cells_agree_exactly(seed):
    rng = np.random.default_rng(seed)
    levels_v = np.linspace(-2.0, 5.0, 8)
    voltage_v = np.append(-2.0, rng.uniform(-3.0, 6.0, 200))
    density, reversible = random_density(7, rng), rng.uniform(size=7)
    regression = everett_regression(voltage_v, levels_v)
    areas_v2 = activation_matrix(voltage_v, levels_v)
    integral = np.append(0.0, np.cumsum(reversible))
    np.testing.assert_allclose(
        regression.matrix @ unknowns_of(density, reversible),
        areas_v2 @ density[np.tril_indices(7)] + np.interp(voltage_v, levels_v, integral),
        atol=1e-12,
    )
    assert (regression.history == 0).all()


def test_the_density_is_the_mixed_difference_of_the_everett_values():
    density = random_density(200, np.random.default_rng(0))
    reversible = np.random.default_rng(1).uniform(size=200)
    returned = density_operator(200) @ unknowns_of(density, reversible)
    np.testing.assert_allclose(returned, density[np.tril_indices(200)], atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_whatever_came_before_is_one_offset_for_each_history(seed):
    rng = np.random.default_rng(seed)
    levels_v = np.linspace(-2.0, 5.0, 8)
    density = random_density(7, rng)[np.tril_indices(7)]
    before_v = np.array([-2.0, *rng.uniform(-2.0, 5.0, 20)])
    voltage_v = np.concatenate([rng.uniform(-1.5, 4.5, 60), [5.0], rng.uniform(-2.0, 5.0, 20)])
    output = activation_matrix(np.append(before_v, voltage_v), levels_v)[before_v.size :] @ density
    regression = everett_regression(voltage_v, levels_v)
    rest = output - regression.matrix @ unknowns_of(lower_triangle(density, 7), np.zeros(7))
    assert (regression.history[60:] == 0).all()
    for number in set(regression.history) - {-1}:
        assert np.ptp(rest[regression.history == number]) < 1e-12
    assert np.count_nonzero(regression.history > 0) > 30


def test_cells_are_visited_where_the_corner_of_the_memory_went():
    levels_v = np.linspace(-2.0, 5.0, 8)
    assert visited_cells(reversal_curves(-2.0, 5.0, 7), levels_v)[np.tril_indices(7)].all()
    loop = visited_cells(reversal_curves(-2.0, 5.0, 1), levels_v)
    expected = np.zeros((7, 7), dtype=bool)
    expected[:, 0] = expected[-1] = True
    np.testing.assert_array_equal(loop, expected)
    jump = visited_cells(np.array([-2.0, 5.0, -2.0]), levels_v)
    assert np.count_nonzero(jump) == 1
    rising = visited_cells(np.linspace(-2.0, 5.0, 50), levels_v, np.arange(20))
    assert rising[:, 0].tolist() == [True, True, True, False, False, False, False]


@pytest.mark.parametrize("seed", range(5))
def test_the_bounded_minimum_is_that_of_nnls(seed):
    rng = np.random.default_rng(seed)
    matrix, target = rng.normal(size=(60, 40)), rng.normal(size=60)
    expected = nnls(matrix, target)[0]
    assert 0 < np.count_nonzero(expected == 0.0) < 40
    solution, _, forces = nonnegative_minimum(
        csr_array(matrix.T @ matrix), matrix.T @ target, csr_array(np.eye(40)),
        np.zeros((40, 0)), np.zeros((0, 0)), np.zeros(0),
    )
    np.testing.assert_allclose(solution, expected, atol=1e-4)
    assert not (forces[expected > 1e-3] > 0.0).any()


def test_variables_beside_may_be_negative():
    solution, beside, _ = nonnegative_minimum(
        csr_array(np.eye(2)), np.array([-1.0, 2.0]), csr_array(np.eye(2)),
        np.zeros((2, 1)), np.eye(1), np.array([-3.0]),
    )
    np.testing.assert_allclose(solution, [0.0, 2.0], atol=1e-4)
    assert beside == pytest.approx(-3.0)


def test_the_curvature_of_a_plane_density_is_zero():
    alpha, beta = np.tril_indices(9)
    curvature = curvature_operator(9)
    np.testing.assert_allclose(curvature @ (2.0 + 3.0 * alpha - beta), 0.0, atol=1e-12)
    assert np.abs(curvature @ (alpha**2.0)).max() == pytest.approx(2.0)


@pytest.mark.long
@pytest.mark.parametrize(("floor", "lowest_v", "highest_v"), [
    (-0.003, 0.0, 50.0), (0.002, -20.0, 120.0), (0.002, 0.0, 50.0), (-0.003, -20.0, 120.0)])
def test_unseen_input_and_its_inverse_are_predicted(lowest_v, highest_v, floor):
    plant = truth(lowest_v, highest_v, floor)
    voltage_v = reversal_curves(lowest_v, highest_v, 70, 600)
    noise_um = NOISE_UM * np.random.default_rng(1).normal(size=voltage_v.size)
    estimate = smoothed_density(
        voltage_v, plant.simulate(voltage_v) + noise_um, np.linspace(lowest_v, highest_v, 141),
        level_count=70,
    )
    assert estimate.visited_fraction == 1.0
    assert estimate.density_um_per_v2.min() >= 0.0
    model = estimate.model()
    unseen_v = unseen_voltage_v(lowest_v, highest_v)
    truth_um = plant.simulate(unseen_v)
    error_um = model.simulate(unseen_v) - truth_um
    span_um = np.diff(plant.output_range_um)
    assert np.abs(error_um - error_um.mean()).max() < 2e-4 * span_um
    wanted_um = np.clip(truth_um + error_um.mean(), *model.output_range_um)
    reached_um = plant.simulate(model.invert(wanted_um)) - truth_um
    assert np.abs(reached_um - reached_um.mean()).max() < 5e-4 * span_um


def test_a_response_that_does_not_wait_at_a_reversal_is_found():
    rate_um_per_v = np.linspace(0.2, 0.5, 1000)
    plant = PreisachModel(
        -20.0, 120.0, truth().density_um_per_v2, -9.0, reversible_um_per_v=rate_um_per_v)
    voltage_v, seen_v = reversal_curves(-20.0, 120.0, 40), unseen_voltage_v(-20.0, 120.0)
    noise_um = np.random.default_rng(2).normal(scale=NOISE_UM, size=voltage_v.size)
    estimate = smoothed_density(
        voltage_v, plant.simulate(voltage_v) + noise_um, np.linspace(-20.0, 120.0, 81),
        smoothing_weight=1e-13)
    expected = np.interp(np.arange(80) + 0.5, 0.08 * (np.arange(1000) + 0.5), rate_um_per_v)
    np.testing.assert_allclose(estimate.reversible_um_per_v, expected, rtol=0.05)
    error_um = estimate.model().simulate(seen_v) - plant.simulate(seen_v)
    assert np.std(error_um) < 2e-4 * np.ptp(plant.simulate(seen_v))


@pytest.mark.long
def test_a_plane_of_200_levels_is_fitted_from_its_reversal_curves():
    plant = truth()
    voltage_v = reversal_curves(-20.0, 120.0, 200)
    noise_um = NOISE_UM * np.random.default_rng(1).normal(size=voltage_v.size)
    estimate = smoothed_density(
        voltage_v, plant.simulate(voltage_v) + noise_um, np.linspace(-20.0, 120.0, 201),
        smoothing_weight=1e-14,
    )
    unseen_v = unseen_voltage_v(-20.0, 120.0)
    error_um = estimate.model().simulate(unseen_v) - plant.simulate(unseen_v)
    assert np.abs(error_um - error_um.mean()).max() < 1e-4 * np.diff(plant.output_range_um)


@pytest.mark.long
def test_a_recording_with_an_unknown_past_and_many_reversals_predicts():
    plant = truth()
    memory = plant.memory()
    plant.simulate([90.0, 3.0, 70.0, 41.0], memory)
    # Growing swings around the middle: neither end of the range is seen before the last ones.
    swings = np.linspace(0.0, 70.0, 90)[1:] * np.where(np.arange(89) % 2, 1.0, -1.0)
    turns_v = 50.0 + np.append(swings, -70.0)
    voltage_v = np.interp(np.arange(0.0, 89.0, 2e-3), np.arange(90), turns_v)
    output_um = plant.simulate(voltage_v, memory)
    output_um = output_um + NOISE_UM * np.random.default_rng(1).normal(size=voltage_v.size)
    estimate = smoothed_density(voltage_v, output_um, np.linspace(-20.0, 120.0, 41))
    inside_v = 50.0 + np.interp(np.arange(0.0, 9.0, 2e-3), np.arange(10), [
        -70.0, 40.0, -30.0, 33.0, -20.0, 12.0, -5.0, 8.0, -30.0, 25.0
    ])
    error_um = estimate.model().simulate(inside_v) - plant.simulate(inside_v)
    assert np.abs(error_um - error_um.mean()).max() < 5e-3 * np.diff(plant.output_range_um)


def test_samples_that_all_lie_on_levels_are_enough():
    plant = truth()
    turns = [turn for top in range(1, 41) for turn in (*range(top), *range(top, 0, -1))]
    voltage_v = -20.0 + 3.5 * np.array([*turns, 0.0])
    levels_v = np.linspace(-20.0, 120.0, 41)
    output_um = plant.simulate(voltage_v)
    model = smoothed_density(voltage_v, output_um, levels_v, smoothing_weight=1e-13).model()
    assert np.abs(model.simulate(voltage_v) - output_um).max() < 5e-3


def test_a_voltage_that_never_returns_is_refused():
    voltage_v = np.linspace(1.0, 2.0, 50)
    with pytest.raises(ValueError, match="record at least one reversal"):
        smoothed_density(voltage_v, voltage_v, np.linspace(0.0, 3.0, 6), smoothing_weight=1e-12)


@pytest.mark.long
@pytest.mark.parametrize(("part", "most_um"), [(0.0, 0.01), (0.3, 0.02)])
def test_a_reversible_part_is_there_only_where_the_loops_ask_for_it(part, most_um):
    """Small loops are as wide as those of the stage, whether it has such a part or not."""
    levels_v = np.linspace(-20.0, 120.0, 701)
    rising_v, falling_v = np.meshgrid(levels_v[:-1], levels_v[:-1], indexing="ij")
    density = np.tril(0.0006 + 0.078 * np.exp(-np.abs(rising_v - falling_v) / 12.0))
    plant = PreisachModel(-20.0, 120.0, density, -9.0)

    def displacement_um(of_v):
        return (1.0 - part) * plant.simulate(of_v) + part * 0.75 * of_v

    lows_v = np.linspace(-20.0, 110.0, 14)
    turns_v = np.append(-20.0, np.column_stack([np.full(14, 120.0), lows_v]).ravel())
    voltage_v = np.interp(np.linspace(0.0, 28.0, 5601), np.arange(29), turns_v)
    output_um = displacement_um(voltage_v)
    output_um += NOISE_UM * np.random.default_rng(0).standard_normal(output_um.size)
    found = smoothed_density(voltage_v, output_um, np.linspace(-20.0, 120.0, 141))
    # A thousandth of the gain, 1 um/V, is beyond what the noise tells.
    assert (found.reversible_um_per_v.max() > 1e-3) == bool(part)
    small_v = 50.0 + np.repeat([5.0, 2.0, 1.0], 200) * np.sin(np.linspace(0.0, 6.0 * np.pi, 600))
    played_v = np.concatenate(
        [np.linspace(-20.0, 120.0, 500), np.linspace(120.0, 50.0, 300), small_v])
    error_um = (found.model().simulate(played_v) - displacement_um(played_v))[-small_v.size :]
    assert np.std(error_um) < most_um
