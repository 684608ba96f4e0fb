# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_sim.plant.plant_file import read_plant
from piezo_sim.simulated_stage import SimulatedStage
from piezo_studies.demo.changed_plants import with_faster_mode, with_sensor_lag, write_plant

RATE_HZ = 40_000.0
STEP_V = np.r_[np.zeros(40), np.full(2000, 1.0)]


def measured(plant):
    stage = SimulatedStage(plant, 1, RATE_HZ)
    stage.open()
    stage.exchange(STEP_V)
    return stage.true_displacement_um


def test_the_last_mode_is_faster_from_a_time_on_and_as_compliant(tmp_path):
    at_once, later = (read_plant(write_plant(
        with_faster_mode("undeclared", 1.03, begin_s), tmp_path / f"{begin_s:g}.yaml"))
        for begin_s in (0.0, 1.0))
    before = measured("undeclared")
    np.testing.assert_array_equal(measured(later), before)
    changed = next(effect for effect in at_once.stage if effect.name == "loaded_mode")
    assert changed.frequency_rad_per_s / np.sqrt(1.0 + changed.added_mass) == pytest.approx(
        1.03 * 4909.0)
    difference = np.abs(measured(at_once) - before)
    assert difference[:200].max() > 0.01
    assert difference[-100:].max() < 0.1 * difference.max()


def test_a_plant_without_a_mode_of_its_own_has_none_that_changes():
    assert with_faster_mode("beam", 1.03, 1.0) is None


def test_a_lag_of_the_sensor_delays_the_reading_and_not_the_stage(tmp_path):
    path = write_plant(with_sensor_lag("undeclared", 2e-4), tmp_path / "new" / "lag.yaml")
    readings = []
    for plant in ("undeclared", path):
        stage = SimulatedStage(plant, 1, RATE_HZ)
        stage.open()
        ramp_v = np.arange(4000) * 1e-3
        readings.append((stage.exchange(ramp_v), stage.true_displacement_um))
    np.testing.assert_array_equal(readings[0][1], readings[1][1])
    speed_um_per_s = np.polyfit(np.arange(1000) / RATE_HZ, readings[0][1][-1000:], 1)[0]
    behind_um = np.mean((readings[0][0] - readings[1][0])[-1000:])
    assert behind_um == pytest.approx(2e-4 * speed_um_per_s, rel=0.02)
