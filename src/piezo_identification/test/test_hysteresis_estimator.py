# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from piezo_identification import experiments
from piezo_identification.hysteresis import (
    density_interpolation,
    estimate_hysteresis,
    hysteresis_output_um,
)
from piezo_identification.nonnegative import nonnegative_minimum
from piezo_identification.waveforms import played
from piezo_models.preisach import PreisachModel

LEVELS = 28
CLOCK_HZ = 4000.0


@pytest.fixture(scope="module")
def recording(play):
    return play(experiments.hysteresis(level_count=LEVELS), 1, CLOCK_HZ)


@pytest.fixture(scope="module")
def estimate(plant, recording):
    return estimate_hysteresis(recording, plant.creep, plant.dynamics, LEVELS, 4)


def unseen_voltage_v():
    turns_v = np.array([-20.0, 97.3, 13.1, 84.7, 22.6, 71.3, 38.2, 110.4, -7.5, 61.9, 9.0])
    return np.interp(np.arange(0.0, 10.0, 1e-3), np.arange(11), turns_v)


def test_a_density_that_is_no_sum_predicts_unseen_input(plant, estimate):
    voltage_v = unseen_voltage_v()
    truth_um = plant.hysteresis.simulate(voltage_v)
    error_um = estimate.simulate(voltage_v) - truth_um
    error_um -= error_um.mean()
    assert np.abs(error_um).max() < 2e-4 * np.ptp(truth_um)


def test_the_estimate_is_nowhere_negative_and_has_an_inverse(estimate):
    assert estimate.density_um_per_v2.min() >= 0.0
    voltage_v = unseen_voltage_v()
    returned_v = estimate.invert(estimate.simulate(voltage_v))
    assert np.abs(returned_v - voltage_v).max() < 1e-5


def test_creep_left_from_before_does_not_disturb(plant, play, estimate):
    memory = plant.memory()
    plant.simulate(np.full(40_000, 120.0), 1e-3, memory)
    recording = play(experiments.hysteresis(level_count=LEVELS), 1, CLOCK_HZ, memory)
    disturbed = estimate_hysteresis(recording, plant.creep, plant.dynamics, LEVELS, 4)
    difference_um = disturbed.simulate(unseen_voltage_v()) - estimate.simulate(unseen_voltage_v())
    assert np.abs(difference_um - difference_um.mean()).max() < 5e-3


def test_the_inverses_of_creep_and_dynamics_leave_the_hysteresis(plant, play):
    recording = play(experiments.hysteresis(level_count=2), clock_hz=CLOCK_HZ, noise_um=0.0)
    part = played(recording)
    output_um = hysteresis_output_um(part, plant.creep, plant.dynamics)
    error_um = output_um - plant.hysteresis.simulate(part.voltage_v)
    trace = np.column_stack([
        np.ones(part.time_s.size), np.exp(-np.outer(part.time_s, plant.creep.zeros_rad_per_s))
    ])[100:]
    rest_um = error_um[100:] - trace @ np.linalg.lstsq(trace, error_um[100:], rcond=None)[0]
    assert np.abs(rest_um[:-1]).max() < 2e-3


def test_more_smoothing_makes_a_smoother_density(plant, recording):
    def roughness(weight):
        model = estimate_hysteresis(
            recording, plant.creep, plant.dynamics, LEVELS, 1, smoothing_weight=weight
        )
        off_diagonal = [np.diagonal(model.density_um_per_v2, -k) for k in range(3, 20)]
        return sum(np.sum(np.diff(diagonal, 2) ** 2) for diagonal in off_diagonal)

    assert roughness(30.0) < roughness(0.1)


@pytest.mark.parametrize("cells_per_level", [1, 2, 3])
def test_a_linear_density_is_interpolated_exactly(cells_per_level):
    def density(alpha, beta):
        return 2.0 + 0.3 * alpha - 0.1 * beta

    interpolation = density_interpolation(5, cells_per_level)
    cells = interpolation @ density(*np.tril_indices(6))
    everett = PreisachModel(
        0.0, 5.0, np.zeros((5 * cells_per_level,) * 2) + _square(cells, 5 * cells_per_level)
    ).everett_um(5.0, 0.0)
    # Mean of a linear density over the triangle is its value at the centroid.
    assert everett == pytest.approx(12.5 * density(10.0 / 3.0, 5.0 / 3.0))
    np.testing.assert_allclose(interpolation.sum(axis=1), 1.0)
    assert interpolation.toarray().min() >= 0.0


def _square(cells, size):
    square = np.zeros((size, size))
    square[np.tril_indices(size)] = cells
    return square


@pytest.mark.parametrize("seed", range(5))
def test_the_constrained_minimum_is_that_of_nnls(seed):
    rng = np.random.default_rng(seed)
    matrix, target = rng.normal(size=(60, 40)), rng.normal(size=60)
    expected = nnls(matrix, target)[0]
    assert 0 < np.count_nonzero(expected == 0.0) < 40
    solution = nonnegative_minimum(matrix.T @ matrix, matrix.T @ target)
    np.testing.assert_allclose(solution, expected, atol=1e-9)


def test_free_variables_may_become_negative():
    solution = nonnegative_minimum(np.eye(3), np.array([-1.0, 2.0, -3.0]), free=1)
    np.testing.assert_allclose(solution, [0.0, 2.0, -3.0])


@pytest.mark.parametrize("voltage_v", [
    np.zeros(1000), np.repeat([40.0, 60.0], 500), np.tile(np.repeat([40.0, 60.0], 10), 50)
])
def test_a_voltage_that_leaves_levels_out_is_refused(plant, recording, voltage_v):
    jumping = replace(
        recording.select(np.arange(recording.voltage_v.size) < 1000), voltage_v=voltage_v
    )
    with pytest.raises(ValueError, match="hysteresis passes by [12] of 71 voltage levels"):
        estimate_hysteresis(jumping, plant.creep, plant.dynamics)


def test_a_displacement_of_the_wrong_sign_is_refused(plant, recording):
    inverted = replace(recording, displacement_um=-recording.displacement_um)
    with pytest.raises(ValueError, match="reverse the sign"):
        estimate_hysteresis(inverted, plant.creep, plant.dynamics, LEVELS)
