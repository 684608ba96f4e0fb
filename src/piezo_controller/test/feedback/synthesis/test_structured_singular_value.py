# SPDX-License-Identifier: BSD-3-Clause
"""Structured singular values and D-K iteration against matrices and plants known in closed form."""

import control
import numpy as np
import pytest

from piezo_controller.feedback.synthesis.dk_iteration import (
    constant_scaling,
    fit_scaling,
    iterate,
    scale,
    tick_frequencies,
)
from piezo_controller.feedback.synthesis.h_infinity import close, is_stable, synthesise
from piezo_controller.feedback.synthesis.structured_singular_value import (
    sampled_response,
    structured_singular_values,
)

pytestmark = pytest.mark.kernels

TICK_S = 1e-3


def random_complex(*shape, seed=1):
    draws = np.random.default_rng(seed)
    return draws.normal(size=shape) + 1j * draws.normal(size=shape)


def test_of_a_rank_one_matrix_is_the_sum_over_the_blocks():
    # For M = a b* and scalar blocks, mu is the sum of |a_i b_i|; the last block is full.
    a, b = random_complex(3, seed=2), random_complex(3, seed=3)
    mu, _ = structured_singular_values(np.outer(a, b.conj())[None], 2)
    assert mu[0] == pytest.approx(np.abs(a * b).sum(), rel=1e-4)


def test_of_a_triangular_matrix_is_its_largest_diagonal_entry():
    matrix = np.triu(random_complex(3, 3))
    mu, _ = structured_singular_values(matrix[None], 2)
    assert mu[0] == pytest.approx(np.abs(np.diag(matrix)).max(), rel=1e-2)


def test_of_one_full_block_is_the_largest_singular_value_and_needs_no_square():
    matrix = random_complex(2, 3)
    mu, scalings = structured_singular_values(matrix[None], 0)
    assert mu[0] == pytest.approx(np.linalg.norm(matrix, 2), rel=1e-6)
    assert scalings.shape == (1, 0)


def test_scalings_reach_the_value_that_no_perturbation_found_beats():
    responses = random_complex(6, 4, 5, seed=4)
    mu, scalings = structured_singular_values(responses, 2)
    draws = np.random.default_rng(5)
    for matrix, value, d in zip(responses, mu, scalings, strict=True):
        left, right = np.diag([*d, 1, 1]), np.diag([*1 / d, 1, 1, 1])
        assert np.linalg.norm(left @ matrix @ right, 2) == pytest.approx(value, rel=1e-3)
        for _ in range(200):
            perturbation = np.zeros((5, 4), dtype=complex)
            perturbation[[0, 1], [0, 1]] = np.exp(2j * np.pi * draws.random(2))
            block = draws.normal(size=(3, 2)) + 1j * draws.normal(size=(3, 2))
            perturbation[2:, 2:] = block / np.linalg.norm(block, 2)
            assert np.abs(np.linalg.eigvals(matrix @ perturbation)).max() <= value * (1 + 1e-6)


def test_constant_scaling_undoes_a_scaling():
    responses = random_complex(5, 2, 2, seed=6)
    responses[:, 0, 1] = responses[:, 1, 0] = np.abs(responses[:, 1, 0])
    plain = constant_scaling(responses, 1)
    responses[:, 0, 1] *= 7.0
    responses[:, 1, 0] /= 7.0
    assert constant_scaling(responses, 1) == pytest.approx(plain / 7.0, rel=1e-2)


def test_fitted_scaling_is_stable_both_ways_and_meets_a_magnitude_of_its_order():
    frequency_hz = tick_frequencies(TICK_S)
    points = np.exp(2j * np.pi * frequency_hz * TICK_S)
    magnitude = 3.0 * np.abs((points - 0.9) / (points - 0.5))
    fitted = fit_scaling(frequency_hz, magnitude, np.ones_like(frequency_hz), TICK_S)
    assert np.abs(fitted(points, squeeze=True)) == pytest.approx(magnitude, rel=1e-3)
    assert is_stable(fitted)
    assert np.abs(fitted.zeros()).max() < 1


def test_scaling_leaves_the_structured_singular_value(two_block_problem):
    points = np.exp(2j * np.pi * tick_frequencies(TICK_S, 20) * TICK_S)
    dynamic = control.ss([[0.5]], [[1.0]], [[0.2]], [[2.0]], TICK_S)
    controller, _ = synthesise(two_block_problem)
    values = [structured_singular_values(sampled_response(close(problem, controller), points), 1)[0]
              for problem in (two_block_problem, scale(two_block_problem, [dynamic]))]
    assert values[0] == pytest.approx(values[1], rel=1e-2)


@pytest.fixture(scope="module")
def two_block_problem():
    """Return a lag with an uncertain gain, whose error and control are weighted in other units."""
    plant = control.ss([[0.9]], [[0.1]], [[1.0]], [[0.0]], TICK_S)
    d_scale = 10.0
    a = plant.A
    b = np.hstack([plant.B * 0.4 * d_scale, np.zeros((1, 2)), plant.B])
    c = np.vstack([np.zeros((1, 1)), -plant.C, np.zeros((1, 1)), -plant.C])
    d = np.array([[0, 0, 0, 1 / d_scale], [0, 1, 0, 0], [0, 0, 0, 0.3], [0, 1, 0.1, 0]])
    return control.ss(a, b, c, d, TICK_S)


def test_iteration_ends_where_the_best_constant_scaling_of_a_sweep_is(two_block_problem):
    swept = min(synthesise(scale(two_block_problem, [d]), tolerance=1e-3)[1]
                for d in np.geomspace(0.3, 100.0, 30))
    synthesis = iterate(two_block_problem, 1)
    assert synthesis.gamma <= swept * 1.01
    assert synthesis.history[-1] <= synthesis.gamma * 1.01
    assert synthesis.history[-1] < 0.95 * synthesis.history[0]


def test_iteration_keeps_the_best_iterate(two_block_problem):
    for dynamic in (False, True):
        synthesis = iterate(two_block_problem, 1, dynamic)
        assert synthesis.history[-1] <= min(synthesis.history) * 1.005
        closed = close(two_block_problem, synthesis.controller)
        assert is_stable(closed) and is_stable(synthesis.controller)
