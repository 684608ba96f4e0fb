# SPDX-License-Identifier: BSD-3-Clause
"""The simulated stage behind the backend protocol."""

from importlib import resources

import numpy as np
import pytest

from piezo_sim.plant.plant_file import PLANTS
from piezo_sim.simulated_stage import SimulatedStage

on_every_plant = pytest.mark.parametrize("plant", PLANTS)


def opened(**options):
    stage = SimulatedStage(**options)
    stage.open()
    return stage


@on_every_plant
def test_calls_of_any_size_give_the_same_samples_to_the_bit(wandering_voltage_v, exchanged, plant):
    whole = exchanged(wandering_voltage_v, wandering_voltage_v.size, plant)
    every = wandering_voltage_v.size
    for size, count in ((1, 500), (40, every), (1000, every), (4096, every), (4097, every)):
        parts = exchanged(wandering_voltage_v[:count], size, plant)
        assert all(np.array_equal(a[:count], b) for a, b in zip(whole, parts, strict=True))


@on_every_plant
def test_opening_again_repeats_the_same_samples(wandering_voltage_v, plant):
    voltage_v = wandering_voltage_v[:5000]
    stage = opened(plant=plant, seed=3)
    first = stage.exchange(voltage_v)
    stage.open()
    assert np.array_equal(stage.exchange(voltage_v), first)
    stage.close()
    stage.open()
    assert np.array_equal(stage.exchange(voltage_v), first)


def test_another_seed_changes_the_noise_and_not_the_position(wandering_voltage_v):
    voltage_v = wandering_voltage_v[:5000]
    one, other = opened(seed=1), opened(seed=2)
    assert not np.array_equal(one.exchange(voltage_v), other.exchange(voltage_v))
    assert np.array_equal(one.true_displacement_um, other.true_displacement_um)


def test_another_seed_changes_jitter_and_drift_of_the_beam_a_little(wandering_voltage_v):
    voltage_v = wandering_voltage_v[:5000]
    one, other = opened(plant="beam", seed=1), opened(plant="beam", seed=2)
    one.exchange(voltage_v)
    other.exchange(voltage_v)
    difference_um = np.abs(one.true_displacement_um - other.true_displacement_um)
    assert 0.0 < difference_um.max() < 0.5


@on_every_plant
def test_a_voltage_acts_only_after_its_own_sample(plant):
    rest_um = opened(plant=plant).exchange(np.zeros(100))
    moved = opened(plant=plant)
    voltage_v = np.zeros(100)
    voltage_v[50:] = 40.0
    moved_um = moved.exchange(voltage_v)
    assert np.array_equal(moved_um[:51], rest_um[:51])
    # Before any mode of vibration turns back.
    assert np.diff(moved.true_displacement_um[50:70]).min() > 0.0


@pytest.mark.parametrize("plant", [None, resources.files("piezo_sim") / "undeclared.yaml"])
def test_the_stage_opens_at_rest_near_zero(plant):
    stage = opened(plant=plant)
    stage.exchange(np.zeros(40_000))
    assert np.ptp(stage.true_displacement_um) < 1e-9
    assert abs(stage.true_displacement_um[0]) < 0.01


def test_the_beam_opens_at_rest_near_zero_and_drifts_from_there():
    stage = opened(plant="beam")
    stage.exchange(np.zeros(40_000))
    assert abs(stage.true_displacement_um[0]) < 0.01
    assert np.ptp(stage.true_displacement_um) < 1e-4


def test_exchange_refuses_what_it_cannot_play():
    stage = SimulatedStage()
    with pytest.raises(RuntimeError, match="call open"):
        stage.exchange(np.zeros(40))
    stage.open()
    with pytest.raises(ValueError, match=r"voltage_v\[2\] is nan"):
        stage.exchange([0.0, 1.0, np.nan])
    with pytest.raises(ValueError, match="one dimension"):
        stage.exchange(np.zeros((2, 2)))
    stage.close()
    with pytest.raises(RuntimeError, match="call open"):
        stage.exchange(np.zeros(40))


@on_every_plant
def test_a_refused_call_leaves_the_stage_untouched(wandering_voltage_v, plant):
    voltage_v = wandering_voltage_v[:200]
    expected = opened(plant=plant, seed=5).exchange(voltage_v)
    stage = opened(plant=plant, seed=5)
    with pytest.raises(ValueError):
        stage.exchange([100.0, np.inf])
    assert np.array_equal(stage.exchange(voltage_v), expected)


@pytest.mark.parametrize("options", [{"seed": -1}, {"sample_rate_hz": 0.0}])
def test_impossible_options_are_refused(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        SimulatedStage(**options)
