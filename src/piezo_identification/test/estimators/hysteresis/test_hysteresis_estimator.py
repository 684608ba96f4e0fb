# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.conditioning.waveforms import played
from piezo_identification.estimators.hysteresis.density_fit import (
    estimate_density,
    hysteresis_output_um,
)
from piezo_identification.experiments import catalogue as experiments
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

pytestmark = pytest.mark.kernels

LEVELS = 28
CLOCK_HZ = 4000.0
SMOOTHING = 1e-13
"""About what the data choose, which takes most of an estimate."""


@pytest.fixture(scope="module")
def recording(play):
    return play(experiments.hysteresis(level_count=LEVELS), 1, CLOCK_HZ)


@pytest.fixture(scope="module")
def estimate(plant, recording):
    return estimate_density(recording, plant.creep, plant.dynamics, LEVELS, 4, SMOOTHING).model()


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
    disturbed = estimate_density(
        recording, plant.creep, plant.dynamics, LEVELS, 4, SMOOTHING).model()
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
        model = estimate_density(
            recording, plant.creep, plant.dynamics, LEVELS, 1, smoothing_weight=weight
        ).model()
        off_diagonal = [np.diagonal(model.density_um_per_v2, -k) for k in range(3, 20)]
        return sum(np.sum(np.diff(diagonal, 2) ** 2) for diagonal in off_diagonal)

    assert roughness(1e-10) < roughness(1e-14)


def test_reversal_curves_visit_the_whole_plane_and_one_loop_two_sides_of_it(plant, play, recording):
    whole = estimate_density(recording, plant.creep, plant.dynamics, LEVELS, 1, SMOOTHING)
    assert whole.visited_fraction == 1.0
    loop = play(experiments.hysteresis(level_count=1, harmonic_period_s=20.0), 1, CLOCK_HZ)
    sides = estimate_density(loop, plant.creep, plant.dynamics, LEVELS, 1, SMOOTHING)
    parts = sides.visited.shape[0] // LEVELS
    of_levels = sides.visited.reshape(LEVELS, parts, LEVELS, parts).any(axis=(1, 3))
    assert np.count_nonzero(of_levels) == 2 * LEVELS - 1
    assert f"{100.0 * sides.visited_fraction:.1f} % of the Preisach plane visited" in sides.report()


def test_a_voltage_that_rests_is_refused(plant, recording):
    resting = replace(recording, voltage_v=np.full(recording.voltage_v.size, 40.0))
    with pytest.raises(ValueError, match="hysteresis is 40 V throughout"):
        estimate_density(resting, plant.creep, plant.dynamics)


def test_a_displacement_of_the_wrong_sign_is_refused(plant, recording):
    inverted = replace(recording, displacement_um=-recording.displacement_um)
    with pytest.raises(ValueError, match="reverse the sign"):
        estimate_density(inverted, plant.creep, plant.dynamics, LEVELS)


def test_inexact_dynamics_do_not_turn_the_sign(recording):
    """Removed from a stage that follows at once, a slow mode turns the sign of its fast motion."""
    time_s = 1e-3 * np.arange(2000)
    voltage_v = 50.0 - 50.0 * np.cos(2.0 * np.pi * 100.0 * time_s)
    fast = replace(recording.select(np.arange(recording.voltage_v.size) < 2000),
                   voltage_v=voltage_v, displacement_um=0.2 * voltage_v, sample_rate_hz=1e3,
                   sample_periods_s=np.full(2000, 1e-3))
    mode = ElectricVibrationDynamics(0.0, (2.0 * np.pi * 40.0,), (0.02,))
    found = estimate_density(fast, CreepDynamics(), mode).model().simulate(voltage_v)
    assert np.ptp(found) == pytest.approx(20.0, rel=1e-3)
