# SPDX-License-Identifier: BSD-3-Clause
"""A model beside a stage that changes while it is watched."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.monitoring.model_monitor import (
    ModelMonitor,
    MonitorSettings,
    largest_part,
)
from piezo_identification.monitoring.usual_error import KnownError
from piezo_models.effects.stiffening import Stiffening

PERIOD_S = 1e-3
SETTINGS = MonitorSettings(block_s=0.2, learning_blocks=60)
LEARNED_S = SETTINGS.block_s * SETTINGS.learning_blocks
CHANGE_S = 16.0
NOISE_UM = 0.009


def tracked_v(duration_s):
    time_s = PERIOD_S * np.arange(round(duration_s / PERIOD_S))
    return 50.0 - 30.0 * np.cos(2 * np.pi * 5.0 * time_s) + 3.0 * np.sin(2 * np.pi * 45.0 * time_s)


def measured_um(stages, voltage_v, change=CHANGE_S, seed=0):
    """Return what the first stage measures before the change, and the second from then on."""
    first, second = (stage.simulate(voltage_v, PERIOD_S) for stage in stages)
    at = PERIOD_S * np.arange(voltage_v.size) < change
    noise = NOISE_UM * np.random.default_rng(seed).normal(size=voltage_v.size)
    return np.where(at, first, second) + noise


def watched(plant, voltage_v, displacement_um, parts=40, settings=SETTINGS):
    monitor = ModelMonitor(plant, PERIOD_S, settings)
    raised = []
    for start in range(0, voltage_v.size, parts):
        raised += monitor.watch(voltage_v[start : start + parts],
                                displacement_um[start : start + parts])
    return monitor, raised


def with_mode(plant, factor):
    frequencies = plant.dynamics.mode_frequencies_rad_per_s
    dynamics = replace(plant.dynamics, mode_frequencies_rad_per_s=(
        frequencies[0] * factor, *frequencies[1:]))
    return replace(plant, dynamics=dynamics)


@pytest.fixture(scope="module")
def real(plant):
    """A stage from which the model differs a little from the beginning."""
    return replace(with_mode(plant, 1.004), hysteresis=replace(
        plant.hysteresis, density_um_per_v2=1.001 * plant.hysteresis.density_um_per_v2))


def test_a_stage_that_stays_as_it_was_raises_nothing(plant, real):
    voltage_v = tracked_v(40.0)
    monitor, raised = watched(plant, voltage_v, measured_um((real, real), voltage_v))
    assert raised == []
    assert not monitor.is_learning


def test_a_mode_that_changes_is_found_in_two_seconds(plant, real):
    voltage_v = tracked_v(20.0)
    changed = with_mode(real, 1.15)
    _, raised = watched(plant, voltage_v, measured_um((real, changed), voltage_v))
    first = raised[0]
    assert CHANGE_S < first.at_s < CHANGE_S + 2.0
    assert abs(first.since_s - CHANGE_S) < 0.5
    assert first.rms_um > 2.0 * first.usual_rms_um
    assert first.probability > 0.99
    assert f"errs by {first.rms_um:.3g} um where" in first.sentence()


def test_a_load_that_takes_a_part_of_the_motion_is_a_change_of_gain(plant, real):
    voltage_v = tracked_v(20.0)
    displacement_um = measured_um((real, real), voltage_v)
    loaded = PERIOD_S * np.arange(voltage_v.size) >= CHANGE_S
    displacement_um[loaded] -= 0.005 * (displacement_um[loaded] - displacement_um[loaded].mean())
    _, raised = watched(plant, voltage_v, displacement_um)
    assert CHANGE_S < raised[0].at_s < CHANGE_S + 2.0
    assert raised[0].statistic == "gain"


def test_a_drift_that_begins_is_found_once_it_is_some_times_the_error(plant, real):
    voltage_v = tracked_v(26.0)
    time_s = PERIOD_S * np.arange(voltage_v.size)
    rate_um_per_s = 0.02
    drift_um = rate_um_per_s * np.maximum(0.0, time_s - CHANGE_S)
    displacement_um = measured_um((real, real), voltage_v) + drift_um
    _, raised = watched(plant, voltage_v, displacement_um)
    assert raised[0].statistic == "mean"
    assert CHANGE_S < raised[0].at_s < CHANGE_S + 2.0 + 2.0 * raised[0].usual_rms_um / rate_um_per_s
    assert "as an offset" in raised[0].sentence()


def test_another_change_is_reported_after_the_first(plant, real):
    voltage_v = tracked_v(30.0)
    displacement_um = measured_um((real, with_mode(real, 1.15)), voltage_v)
    displacement_um += (PERIOD_S * np.arange(voltage_v.size) >= 24.0) * (
        displacement_um - plant.simulate(voltage_v, PERIOD_S))
    _, raised = watched(plant, voltage_v, displacement_um)
    assert [round(found.since_s) for found in raised] == [16, 24]
    assert raised[1].usual_rms_um == pytest.approx(raised[0].rms_um, rel=0.2)


def test_a_change_is_found_while_what_is_usual_is_learned(plant, real):
    voltage_v = tracked_v(8.0)
    displacement_um = measured_um((real, with_mode(real, 1.15)), voltage_v, change=4.0)
    known = KnownError(part_of_motion=2e-3, noise_um=NOISE_UM, spread=0.7)
    monitor = ModelMonitor(plant, PERIOD_S, SETTINGS, known=known)
    raised = monitor.watch(voltage_v, displacement_um)
    assert 4.0 < raised[0].at_s < 6.0
    assert monitor.is_learning


def test_parts_of_any_size_raise_the_same(plant, real):
    voltage_v = tracked_v(18.0)
    displacement_um = measured_um((real, with_mode(real, 1.15)), voltage_v)
    raised = [watched(plant, voltage_v, displacement_um, parts)[1] for parts in (37, 1000, 18_000)]
    assert raised[0] and raised[0] == raised[1] == raised[2]


def test_what_it_holds_does_not_grow(plant, real):
    voltage_v = tracked_v(20.0)
    monitor = ModelMonitor(plant, PERIOD_S, SETTINGS)
    displacement_um = measured_um((real, real), voltage_v)

    def held():
        return sum(part.size for part in monitor._waiting_v), len(monitor._memory.effects)

    monitor.watch(voltage_v, displacement_um)
    before = held()
    for _ in range(3):
        monitor.watch(voltage_v[15_000:], displacement_um[15_000:])
    assert held() == before


def test_it_learns_anew_when_told(plant, real):
    voltage_v = tracked_v(14.0)
    displacement_um = measured_um((real, real), voltage_v)
    monitor, _ = watched(plant, voltage_v, displacement_um)
    monitor.begin_anew()
    assert monitor.is_learning
    assert monitor.watch(voltage_v[-2000:], displacement_um[-2000:] + 1.0) == []


def test_a_model_that_remembers_everything_is_refused(plant):
    spring = Stiffening(0.0, 0.0, 1.0, 30.0, 30.0, 3000.0, 0.5)
    with pytest.raises(ValueError, match="stiffening, which remembers all of the past"):
        ModelMonitor(replace(plant, effects=(spring,)), PERIOD_S)
    with pytest.raises(ValueError, match="make it longer"):
        ModelMonitor(plant, PERIOD_S, MonitorSettings(block_s=0.002))


def test_the_largest_part_of_an_error_is_named():
    motion = np.sin(2.0 * np.pi * np.arange(400) / 40.0)
    late = 3.0 * np.gradient(motion)
    noise = np.random.default_rng(3).normal(size=400)
    for residual, offset, expected in (
            (0.02 * motion, 1.0, "mean"), (0.02 * motion, 0.0, "gain"), (-0.3 * late, 0.01, "lag"),
            (noise + 0.1 * motion, 0.0, "scatter")):
        assert largest_part(residual, offset, motion) == expected
