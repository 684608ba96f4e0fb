# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_identification.fitting.least_damped_modes import with_least_damped_modes
from piezo_models import CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel
from piezo_models.effects.coupled_mode import CoupledMode
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode

HIGHEST_RAD_PER_S = 2e4
CREEP = CreepDynamics((0.1, 10.0), (0.102, 10.1))
LINE = PreisachModel.line(0.0, 100.0, 0.3)


def model(dynamics, *effects):
    return StageModel(LINE, CREEP, dynamics, effects=effects)


@pytest.mark.parametrize("lags", [(), (SensorLag(4e-5),)])
def test_a_damped_mode_becomes_a_lag_and_a_delay_of_nearly_the_same_response(lags):
    slow, fast = (3000.0, 0.01), (2e4, 0.8)
    given = model(ElectricVibrationDynamics(
        1e-4, (slow[0], fast[0]), (slow[1], fast[1])), *lags)
    found, delay_s = with_least_damped_modes(given, 5e-5, HIGHEST_RAD_PER_S)
    assert found.dynamics.mode_frequencies_rad_per_s == slow[:1]
    assert found.dynamics.damping_ratios == slow[1:]
    assert [type(effect) for effect in found.effects] == [type(effect) for effect in lags]
    late_s = 1e-4 + 5e-5 + 2.0 * fast[1] / fast[0] + sum(lag.time_constant_s for lag in lags)
    lags_s = found.dynamics.time_constant_s + sum(lag.time_constant_s for lag in found.effects)
    assert lags_s + delay_s == pytest.approx(late_s, rel=0.05)
    frequency_hz = np.linspace(1.0, 600.0, 50)
    before, after = (
        each.small_signal_response(frequency_hz)
        for each in (replace_delay(given, 5e-5), replace_delay(found, delay_s)))
    np.testing.assert_allclose(after, before, atol=0.03 * np.abs(before).max())


def test_several_modes_that_remain_make_up_the_displacement():
    modes = (VibrationMode(3000.0, 0.01, 0.6), VibrationMode(5000.0, 0.02, 0.3),
             VibrationMode(8000.0, 0.3, -0.2))
    found, _ = with_least_damped_modes(
        model(ElectricVibrationDynamics(1e-4), *modes), 0.0, HIGHEST_RAD_PER_S)
    assert [effect.participation for effect in found.effects] == pytest.approx([2 / 3, 1 / 3])
    assert [effect.frequency_rad_per_s for effect in found.effects] == [3000.0, 5000.0]


def test_coupled_modes_become_the_nearest_possible_modes_of_a_structure():
    modes = (CoupledMode(3000.0, 0.2, 0.5), CoupledMode(5000.0, 0.6, 0.4, 0.1),
             CoupledMode(8000.0, 1.5, 0.1))
    found, _ = with_least_damped_modes(
        model(ElectricVibrationDynamics(1e-4), *modes), 0.0, HIGHEST_RAD_PER_S)
    assert [type(effect) for effect in found.effects] == [VibrationMode, VibrationMode]
    assert [effect.damping_ratio for effect in found.effects] == [0.2, 0.4]


def test_modes_in_series_and_in_parallel_that_remain_stay_there():
    found, _ = with_least_damped_modes(
        model(ElectricVibrationDynamics(1e-4, (3000.0,), (0.01,)), VibrationMode(5000.0, 0.02, 0.3),
              VibrationMode(8000.0, 0.3, 0.2)), 0.0, HIGHEST_RAD_PER_S)
    assert found.dynamics.mode_frequencies_rad_per_s == (3000.0,)
    # Of the displacement, half followed the mode in series.
    assert found.effects[0].participation == pytest.approx(0.3 / (0.3 + 0.5))


@pytest.mark.parametrize("given", [
    model(ElectricVibrationDynamics(1e-4)),
    model(ElectricVibrationDynamics(1e-4, (3000.0,), (0.01,))),
    model(ElectricVibrationDynamics(1e-4), VibrationMode(3000.0, 0.01, 0.6),
          VibrationMode(5000.0, 0.03, 0.4)),
    model(ElectricVibrationDynamics(1e-4), VibrationMode(3000.0, 0.01, -0.6),
          VibrationMode(5000.0, 0.3, 1.6)),
], ids=["no mode", "one mode", "modes of similar damping", "a negative mode"])
def test_nothing_is_replaced_where_no_mode_may_stand_for_a_delay(given):
    assert with_least_damped_modes(given, 0.0, HIGHEST_RAD_PER_S) is None


def replace_delay(given, delay_s):
    """Return a model with a delay."""
    return model(given.dynamics, *given.effects, Delay(delay_s))
