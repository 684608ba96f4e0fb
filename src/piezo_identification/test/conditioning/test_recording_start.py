# SPDX-License-Identifier: BSD-3-Clause
"""Recordings that begin anywhere, of a stage that shares no form with the model."""

import numpy as np
import pytest

from piezo_identification.conditioning.waveforms import square_part
from piezo_identification.estimators.creep.square_wave_creep import estimate_creep
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
from piezo_identification.identification.linear_dynamics import estimate_linear_dynamics
from piezo_models.linear.dynamics import CreepDynamics

LEVELS_V = np.array([10.0, 50.0])
NOISE_UM = 0.003


def square(first, runs, samples):
    return np.repeat([LEVELS_V[(first + run) % 2] for run in range(runs)], samples)


@pytest.mark.parametrize(("first", "past_v"), [
    pytest.param(0, (), id="lower-virgin"),
    pytest.param(1, (0.0, 60.0, 0.0), id="upper-cycled"),
    pytest.param(0, (0.0, 60.0, 0.0), id="lower-cycled", marks=pytest.mark.long),
    pytest.param(1, (), id="upper-virgin", marks=pytest.mark.long)])
def test_creep_may_begin_at_either_level(independent_stage, recorded, first, past_v):
    voltage_v = square(first, 5, 3000)
    displacement_um = independent_stage().displacement_um(voltage_v, 0.01, past_v)
    estimate = estimate_creep(recorded("creep", voltage_v, displacement_um, 0.01, NOISE_UM, 4))
    poles, deviations = estimate.model.poles_rad_per_s, estimate.standard_deviations
    assert poles == pytest.approx((0.125, 2.0), rel=0.02)
    assert abs(poles[0] - 0.125) < 3.0 * deviations["poles_rad_per_s"][0]
    # The way up to the first upper level ends on the loop, that to the first lower one does not.
    assert ("left out" in estimate.start) == (first == 0)


def test_what_comes_before_the_first_step_is_used_where_it_is_on_the_loop(
        independent_stage, recorded):
    voltage_v = square(0, 5, 3000)
    stage = independent_stage()
    settled_v = [10.0, 50.0, 10.0, 50.0, 10.0]
    displacement_um = stage.displacement_um(voltage_v, 0.01, settled_v)
    estimate = estimate_creep(recorded("creep", voltage_v, displacement_um, 0.01, NOISE_UM))
    assert estimate.start == ""
    assert estimate.model.poles_rad_per_s == pytest.approx((0.125, 2.0), rel=0.02)


def test_a_square_wave_may_come_from_rest_anywhere_and_end_there(independent_stage, recorded):
    way_v = np.linspace(0.0, 50.0, 40)
    voltage_v = np.concatenate([np.zeros(500), way_v, square(1, 4, 3000), np.full(200, 30.0)])
    displacement_um = independent_stage().displacement_um(voltage_v, 0.01)
    recording = recorded("creep", voltage_v, displacement_um, 0.01, NOISE_UM)
    part = square_part(recording)
    # The last sample of the way has reached the level.
    assert part.sample_index[[0, -1]].tolist() == [539, 12539]
    assert estimate_creep(recording).model.poles_rad_per_s == pytest.approx((0.125, 2.0), rel=0.02)


@pytest.mark.parametrize("first", [
    pytest.param(0, marks=pytest.mark.long, id="lower"), pytest.param(1, id="upper")])
def test_dynamics_may_begin_at_either_level_and_in_motion(independent_stage, recorded, first):
    stage = independent_stage((0.125,), (0.04,), 5e-4, 2500.0, 0.1)
    creep = CreepDynamics((0.125,), (0.125 * 1.04,))
    voltage_v = np.concatenate([np.zeros(400), square(first, 60, 400)])
    displacement_um = stage.displacement_um(voltage_v, 25e-6, settled=False)
    recording = recorded("dynamics", voltage_v, displacement_um, 25e-6, NOISE_UM)
    estimate = estimate_dynamics(recording, creep, 1)
    for name, truth in (("time_constant_s", 5e-4), ("mode_frequencies_rad_per_s", 2500.0),
                        ("damping_ratios", 0.1)):
        value = np.ravel(getattr(estimate.model, name))[0]
        assert abs(value - truth) < 4.0 * np.ravel(estimate.standard_deviations[name])[0], name


def test_a_voltage_of_more_than_two_levels_is_left_as_it_is(recorded):
    voltage_v = np.sin(np.arange(4000) / 50.0)
    recording = recorded("sine", voltage_v, voltage_v, 0.01)
    assert square_part(recording) is recording


def test_a_square_wave_ends_where_a_slow_ramp_begins(recorded):
    slow_v = np.linspace(LEVELS_V[1], 0.0, 2000)
    voltage_v = np.concatenate([slow_v[::-1], square(0, 9, 1000), slow_v[1:]])
    part = square_part(recorded("square", voltage_v, voltage_v, 0.01))
    assert np.unique(part.voltage_v).tolist() == LEVELS_V.tolist()
    noisy_v = voltage_v + 0.01 * np.random.default_rng(1).normal(size=voltage_v.size)
    assert abs(square_part(recorded("noisy", noisy_v, voltage_v, 0.01)).voltage_v.size - 9001) < 20


@pytest.mark.parametrize("late", [
    pytest.param(0, id="start of hold"),
    pytest.param(1, id="end of hold", marks=pytest.mark.long)])
def test_steps_between_three_levels_are_no_square_wave_of_one_step(
        independent_stage, recorded, late):
    voltage_v = np.repeat([50.0, 90.0, 10.0, 50.0], [100, 1600, 1600, 1600])
    # This stage shows in each row what its voltage has done.
    displacement_um = independent_stage().displacement_um(voltage_v, 0.05)
    if late == 0:
        displacement_um = np.append(displacement_um[0], displacement_um[:-1])
    recording = recorded("creep", voltage_v, displacement_um, 0.05, NOISE_UM)
    assert square_part(recording) is recording
    found = estimate_linear_dynamics([recording], [], [])
    assert found.creep.poles_rad_per_s == pytest.approx((0.125, 2.0), rel=0.1)
    # With a way back to its first level it is one, whatever it came from.
    back_v = np.repeat([50.0, 90.0, 10.0, 90.0, 50.0], [100, 2400, 2400, 2400, 100])
    back = recorded("creep", back_v, back_v, 0.05, NOISE_UM)
    assert set(square_part(back).voltage_v) == {10.0, 90.0}
