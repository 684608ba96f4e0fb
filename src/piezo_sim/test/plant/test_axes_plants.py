# SPDX-License-Identifier: BSD-3-Clause
"""Plants of several axes: what their mechanics do, and how they are described and driven."""

import dataclasses
from importlib import resources

import numpy as np
import pytest
import yaml

from piezo_sim.plant.mechanism import Mechanism, MechanismRunner
from piezo_sim.plant.named_plants import AXES_PLANTS
from piezo_sim.plant.plant_effect import PlantConfigError
from piezo_sim.plant.plant_file import parse_plant, read_any_plant, read_plant
from piezo_sim.simulated_stage import SimulatedStage

PERIOD_S = 2.5e-5

on_every_plant = pytest.mark.parametrize("plant", AXES_PLANTS)


def opened(plant, **options):
    stage = SimulatedStage(plant, **options)
    stage.open()
    return stage


def wandering_v(samples):
    steps = np.random.default_rng(7).normal(0.0, 3.0, (samples, 2))
    return 50.0 + 40.0 * np.sin(np.cumsum(steps, axis=0) / 60.0)


def xy_content():
    return yaml.safe_load((resources.files("piezo_sim") / AXES_PLANTS["xy"]).read_text())


def slowly_moved_um(plant, axis):
    """Return the spans of both readings while one axis moves over 100 V within a second."""
    voltage_v = np.zeros((40_000, 2))
    voltage_v[:, axis] = 50.0 - 50.0 * np.cos(2.0 * np.pi * np.linspace(0.0, 1.0, 40_000))
    return np.ptp(opened(plant, seed=1).exchange(voltage_v), axis=0)


def test_one_mass_on_a_spring_follows_the_textbook():
    w, damping, stroke_um = 2.0 * np.pi * 300.0, 0.1, 3.0
    one = np.ones((1, 1))
    runner = MechanismRunner(
        Mechanism(2.0 * one, 2.0 * w**2 * one, 0.5 * w**2 * one, one, one, np.array([damping])),
        PERIOD_S)
    position_um, _ = runner.respond(np.full((2000, 1), stroke_um))
    time_s = PERIOD_S * np.arange(2000)
    turning = w * np.sqrt(1.0 - damping**2)
    expected_um = stroke_um / 4.0 * (1.0 - np.exp(-damping * w * time_s) * (
        np.cos(turning * time_s) + damping * w / turning * np.sin(turning * time_s)))
    np.testing.assert_allclose(position_um[:, 0], expected_um, atol=1e-9)


def test_resting_mechanism_stands_still():
    mechanism = read_any_plant("serial").mechanics.mechanism()
    runner, strokes_um = MechanismRunner(mechanism, PERIOD_S), np.array([3.0, 20.0])
    readings_um = runner.rest(strokes_um)
    _, seen_um = runner.respond(np.tile(strokes_um, (500, 1)))
    np.testing.assert_allclose(seen_um, np.tile(readings_um, (500, 1)), atol=1e-9)


@on_every_plant
def test_calls_of_any_size_give_the_same_samples_to_the_bit(plant):
    voltage_v = wandering_v(3000)
    whole_um = opened(plant, seed=3).exchange(voltage_v)
    for size, count in ((1, 500), (40, 3000), (1001, 3000)):
        stage = opened(plant, seed=3)
        parts_um = [stage.exchange(voltage_v[first:first + size])
                    for first in range(0, count, size)]
        assert np.array_equal(np.concatenate(parts_um), whole_um[:count])


@on_every_plant
def test_a_voltage_acts_only_after_its_own_sample_and_on_both_axes(plant):
    voltage_v = np.zeros((400, 2))
    rest_um = opened(plant).exchange(voltage_v)
    voltage_v[50:, 0] = 40.0
    stage = opened(plant)
    moved_um = stage.exchange(voltage_v)
    assert np.array_equal(moved_um[:51], rest_um[:51])
    assert np.ptp(stage.true_displacement_um[:, 1]) > 0.1


@on_every_plant
def test_plant_opens_at_rest_near_zero_with_noise_of_its_own_on_each_axis(plant):
    stage = opened(plant, seed=1)
    noise_um = stage.exchange(np.zeros((4000, 2))) - stage.true_displacement_um[0]
    assert np.abs(stage.true_displacement_um).max() < 0.3
    assert np.ptp(stage.true_displacement_um, axis=0).max() < 1e-6
    assert abs(np.corrcoef(noise_um.T)[0, 1]) < 0.1


@pytest.mark.parametrize(("axis", "other"), [(0, 1), (1, 0)])
def test_static_coupling_of_the_flexure_lies_between_minus_35_and_minus_30_db(axis, other):
    span_um = slowly_moved_um("xy", axis)
    assert 25.0 < span_um[axis] < 40.0
    assert -35.0 < 20.0 * np.log10(span_um[other] / span_um[axis]) < -30.0


def modes_hz(mechanics):
    """Return the modes without damping, the lowest first."""
    mechanism = mechanics.mechanism()
    squares = np.linalg.eigvals(np.linalg.solve(mechanism.mass, mechanism.stiffness))
    return np.sqrt(np.sort(squares.real)) / (2.0 * np.pi)


def test_every_mode_of_a_serial_stage_falls_with_the_mass_of_the_platform():
    light = read_any_plant("serial").mechanics
    heavy = dataclasses.replace(light, platform_mass_kg=2.0 * light.platform_mass_kg)
    assert np.all(modes_hz(heavy) < 0.999 * modes_hz(light))


def test_each_axis_rests_at_its_own_voltage():
    stage = opened("xy", rest_voltage_v=(30.0, 0.0))
    stage.exchange(np.tile([30.0, 0.0], (400, 1)))
    assert np.ptp(stage.true_displacement_um, axis=0).max() < 1e-6
    assert stage.true_displacement_um[0, 0] > 5.0 > abs(stage.true_displacement_um[0, 1])


def test_exchange_refuses_what_is_not_of_all_axes():
    stage = opened("xy")
    for shape in ((40,), (40, 3), ()):
        with pytest.raises(ValueError, match="give a column for x and y"):
            stage.exchange(np.zeros(shape))
    with pytest.raises(ValueError, match=r"voltage_v\[2, 1\] is nan"):
        stage.exchange([[0.0, 1.0], [0.0, 1.0], [0.0, np.nan]])


def test_plant_of_several_axes_is_refused_by_name_where_one_is_wanted():
    with pytest.raises(PlantConfigError, match="xy: the plant has the axes x, y; give one of one"):
        read_plant("xy")


def test_file_whose_mechanics_move_another_number_of_axes_is_refused():
    content = xy_content()
    content["axes"]["z"] = content["axes"]["y"]
    with pytest.raises(PlantConfigError, match="mechanics xy_flexure moves 2 axes, and axes has 3"):
        parse_plant(yaml.safe_dump(content))


def test_axis_whose_name_could_not_stand_in_a_table_is_refused():
    content = xy_content()
    content["axes"]["Slow Axis"] = content["axes"].pop("y")
    with pytest.raises(PlantConfigError, match='axes has the name "Slow Axis"; give short lower'):
        parse_plant(yaml.safe_dump(content))


def test_what_is_wrong_in_a_file_of_several_axes_is_named_with_its_axis():
    content = xy_content()
    content["axes"]["y"]["sensor"][0]["effect"] = "warp_drive"
    with pytest.raises(PlantConfigError, match=r"axes\.y\.sensor\[0\]\.effect names an unknown"):
        parse_plant(yaml.safe_dump(content))
    content = xy_content()
    content["mechanics"]["mass_kg"]["value"] = -1.0
    with pytest.raises(PlantConfigError, match="xy_flexure: mass_kg must be positive"):
        parse_plant(yaml.safe_dump(content))
