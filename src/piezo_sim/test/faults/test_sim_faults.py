# SPDX-License-Identifier: BSD-3-Clause
"""Faults spoil the samples of their time, and no others."""

import dataclasses

import numpy as np
import pytest

from piezo_sim.faults.device_failure import DeviceFailure
from piezo_sim.faults.sensor_faults import NoisySensor, OffScaleSensor, SilentSensor, StuckSensor
from piezo_sim.plant.plant_effect import PlantConfigError
from piezo_sim.plant.plant_file import read_plant
from piezo_sim.simulated_stage import SimulatedStage
from piezo_stage_driver.backends.backend import BackendFault

VOLTAGE_V = 50.0 * np.sin(np.arange(4000) * 0.005) ** 2
WINDOW = slice(1000, 1500)
TIMES_S = (0.025, 0.0375)


def readings_um(*faults, stretch=4000):
    plant = read_plant()
    stage = SimulatedStage(dataclasses.replace(plant, sensor=(*plant.sensor, *faults)), seed=3)
    stage.open()
    return np.concatenate([stage.exchange(VOLTAGE_V[at:at + stretch])
                           for at in range(0, 4000, stretch)])


@pytest.mark.parametrize("stretch", [4000, 40])
@pytest.mark.parametrize(("fault", "law"), [
    (StuckSensor(*TIMES_S), lambda spoilt, good: np.all(spoilt == good[0])),
    (SilentSensor(*TIMES_S), lambda spoilt, good: np.isnan(spoilt).all()),
    (OffScaleSensor(*TIMES_S, 150.0), lambda spoilt, good: np.all(spoilt == 150.0)),
    (NoisySensor(*TIMES_S, 2.0), lambda spoilt, good: 1.8 < np.std(spoilt - good) < 2.2),
], ids=["stuck", "silent", "off_scale", "noisy"])
def test_fault_spoils_its_window_only(fault, law, stretch):
    good, spoilt = readings_um(), readings_um(fault, stretch=stretch)
    assert law(spoilt[WINDOW], good[WINDOW])
    outside = np.ones(4000, bool)
    outside[WINDOW] = False
    assert np.array_equal(spoilt[outside], good[outside])


def test_failed_device_exchanges_nothing():
    with pytest.raises(BackendFault, match="the simulated device failed"):
        readings_um(DeviceFailure(*TIMES_S))


def test_device_that_has_failed_plays_nothing_before_it_is_opened_again():
    plant = read_plant()
    stage = SimulatedStage(dataclasses.replace(
        plant, sensor=(*plant.sensor, DeviceFailure(*TIMES_S))))
    stage.open()
    with pytest.raises(BackendFault):
        stage.exchange(VOLTAGE_V)
    with pytest.raises(RuntimeError, match="call nothing but close"):
        stage.exchange(VOLTAGE_V)
    stage.close()
    stage.open()
    assert len(stage.exchange(VOLTAGE_V[:40])) == 40


def test_window_that_ends_before_it_begins_is_refused():
    with pytest.raises(PlantConfigError, match="begin_s must be"):
        SilentSensor(1.0, 1.0)
