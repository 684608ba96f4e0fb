# SPDX-License-Identifier: BSD-3-Clause
from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.conditioning.creep_removal import remove_creep
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
from piezo_identification.experiments import catalogue as experiments
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import (
    CreepDynamics,
    ElectricVibrationDynamics,
    simulate_linear,
    zoh,
)


@pytest.mark.parametrize("seed", [
    1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3, 4, 5))])
def test_time_constant_and_modes_are_recovered_through_noise(plant, play, seed):
    recording = play(experiments.dynamics(duration_s=1.0), seed)
    estimate = estimate_dynamics(recording, plant.creep).model
    assert estimate.time_constant_s == pytest.approx(0.00049, rel=1e-3)
    assert estimate.mode_frequencies_rad_per_s[0] == pytest.approx(2846.0, rel=5e-4)
    assert estimate.mode_frequencies_rad_per_s[1] == pytest.approx(4909.0, rel=1e-4)
    assert estimate.damping_ratios[0] == pytest.approx(0.685, rel=1e-3)
    assert estimate.damping_ratios[1] == pytest.approx(0.082, rel=2e-3)


@pytest.mark.kernels
def test_creep_left_from_before_does_not_disturb(plant, play):
    memory = plant.memory()
    plant.simulate(np.full(40_000, 120.0), 1e-3, memory)
    recording = play(
        experiments.dynamics(duration_s=0.5), memory=memory, noise_um=0.0)
    estimate = estimate_dynamics(recording, plant.creep, 2).model
    assert estimate.time_constant_s == pytest.approx(0.00049, rel=1e-5)
    assert estimate.mode_frequencies_rad_per_s == pytest.approx((2846.0, 4909.0), rel=1e-5)


@pytest.mark.usefixtures("many_poles")
@pytest.mark.parametrize("truth", [
    ElectricVibrationDynamics(0.001),
    pytest.param(ElectricVibrationDynamics(0.001, (3000.0,), (0.1,)), marks=pytest.mark.long),
    pytest.param(ElectricVibrationDynamics(0.0002, (2000.0, 5000.0, 9000.0), (0.02, 0.05, 0.05)),
                 marks=pytest.mark.long),
])
def test_the_number_of_modes_is_that_of_the_plant(plant, play, truth):
    recording = play(
        experiments.dynamics(duration_s=0.8), 1, stage=replace(plant, dynamics=truth))
    estimate = estimate_dynamics(recording, plant.creep).model
    assert estimate.time_constant_s == pytest.approx(truth.time_constant_s, rel=2e-3)
    assert estimate.mode_frequencies_rad_per_s == pytest.approx(
        truth.mode_frequencies_rad_per_s, rel=1e-3
    )
    assert estimate.damping_ratios == pytest.approx(truth.damping_ratios, rel=1e-2)


@pytest.mark.parametrize("truth", [
    ElectricVibrationDynamics(0.0001, (2700.0, 5200.0), (0.015, 0.02), (3600.0,), (0.02,)),
    pytest.param(ElectricVibrationDynamics(
        0.0003, (1500.0, 3000.0, 5200.0), (0.02, 0.03, 0.02), (2200.0, 4500.0), (0.03, 0.02)),
        marks=pytest.mark.long),
])
def test_modes_that_move_side_by_side_are_found_with_their_antiresonances(plant, play, truth):
    recording = play(
        experiments.dynamics(duration_s=0.8), 1, stage=replace(plant, dynamics=truth))
    estimate = estimate_dynamics(recording, plant.creep)
    assert str(estimate.order) == f"{len(truth.damping_ratios)}-{len(truth.damping_ratios) - 1}"
    frequency_hz = np.geomspace(10.0, 1500.0, 200)
    difference = estimate.model.response(frequency_hz) / truth.response(frequency_hz) - 1.0
    assert np.abs(difference).max() < 5e-3


@pytest.mark.parametrize("ringing", [
    VibrationMode(7234.0, 0.005, -0.03),
    pytest.param(VibrationMode(9000.0, 0.005, 0.1), marks=pytest.mark.long)])
def test_with_fewer_modes_than_the_stage_has_those_that_move_it_most_are_found(
        plant, play, ringing):
    recording = play(
        experiments.dynamics(duration_s=1.0), 1, stage=replace(plant, effects=(ringing,)))
    estimate = estimate_dynamics(recording, plant.creep, 2).model
    assert estimate.mode_frequencies_rad_per_s[0] == pytest.approx(2846.0, rel=0.2)
    assert estimate.mode_frequencies_rad_per_s[1] == pytest.approx(4909.0, rel=0.02)


def test_the_inverse_takes_creep_off(plant):
    signal = np.sin(np.arange(20_000) * 2e-3)
    crept = simulate_linear(zoh(plant.creep.state_space(), 1e-3), signal)
    np.testing.assert_allclose(remove_creep(crept, plant.creep, 1e-3), signal, atol=1e-4)


def test_averaged_samples_are_refused(play):
    recording = play(experiments.creep(period_s=4.0), clock_hz=2000.0)
    with pytest.raises(ValueError, match="full sample clock"):
        estimate_dynamics(recording, CreepDynamics())


@pytest.mark.long
def test_rounding_of_the_record_does_not_show_in_the_estimate(plant, play):
    # Over so short a record the decays of slow creep differ by hardly more than the rounding.
    creep = CreepDynamics((0.0035, 0.017, 0.11, 0.25, 1.2, 15.0), (0.0036, 0.0173, 0.115, 0.26,
                                                                  1.21, 15.7))
    stage = replace(plant, creep=creep, effects=(VibrationMode(8796.0, 0.01, 0.004),))
    recording = play(experiments.dynamics(), 1, stage=stage)
    generator = np.random.default_rng(1)
    rounding = 1e-15 * generator.normal(size=(2, recording.displacement_um.size))
    estimates = [estimate_dynamics(
        replace(recording, displacement_um=recording.displacement_um * (1.0 + part)), creep, 2,
    ).model for part in rounding]
    for estimate in estimates[1:]:
        assert estimate.time_constant_s == pytest.approx(estimates[0].time_constant_s, rel=1e-6)
        assert estimate.mode_frequencies_rad_per_s == pytest.approx(
            estimates[0].mode_frequencies_rad_per_s, rel=1e-6)
        assert estimate.damping_ratios == pytest.approx(estimates[0].damping_ratios, rel=1e-6)
