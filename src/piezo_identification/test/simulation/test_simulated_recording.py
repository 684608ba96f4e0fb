# SPDX-License-Identifier: BSD-3-Clause
"""Effects one behind another: which of them are simulated anew when one of them changes."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from piezo_identification.experiments import catalogue as experiments
from piezo_identification.simulation import past_search
from piezo_identification.simulation.past_search import simulated_recording
from piezo_identification.simulation.simulated_recording import KEPT_OUTPUTS
from piezo_models.cascade import StageModel
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.backlash import Backlash
from piezo_models.effects.curved_bouc_wen_hysteresis import CurvedBoucWenHysteresis
from piezo_models.effects.effect import parameter
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.sensor_nonlinearity import SensorNonlinearity
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.effects.voltage_clipping import VoltageClipping
from piezo_models.hysteresis.first_rise import FirstRise
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder import recording_of


@dataclass(frozen=True)
class CountedBacklash(Backlash):
    """Tells of each time that it is applied."""

    applied: ClassVar[list] = []
    number: float = parameter("1", default=0.0)

    def apply(self, signal, sample_period_s, rest=None):
        self.applied.append(self.number)
        return super().apply(signal, sample_period_s, rest)


def sensor(cubic):
    return SensorNonlinearity(0.1, 0.5, cubic, 0.1, 50.0, 50.0)


@pytest.fixture
def recording(plant, play):
    CountedBacklash.applied.clear()
    return simulated_recording(plant, play(experiments.validation(arc_s=0.02, tones_s=0.2), 1))


def test_an_effect_is_simulated_once_while_only_what_lies_behind_it_changes(recording):
    ahead = CountedBacklash(0.05)
    for cubic in (0.1, 0.2, 0.3):
        expected_um = sensor(cubic).apply(
            Backlash(0.05).apply(recording.simulate(), recording.sample_period_s,
                                 recording.rest_um),
            recording.sample_period_s, recording.rest_um)
        np.testing.assert_array_equal(recording.simulate((ahead, sensor(cubic))), expected_um)
    assert CountedBacklash.applied == [0.0]


def test_what_is_used_is_kept_and_what_is_not_goes(recording):
    kept = CountedBacklash(0.05)
    for number in range(1, 2 * KEPT_OUTPUTS):
        recording.simulate((kept, sensor(0.1 * number)))
        recording.simulate((CountedBacklash(0.05, number), sensor(0.1)))
    assert CountedBacklash.applied.count(0.0) == 1
    recording.simulate((CountedBacklash(0.05, 1), sensor(0.1)))
    assert CountedBacklash.applied.count(1.0) == 2


def test_a_hysteresis_behind_an_effect_on_the_voltage_is_simulated_alone(recording, monkeypatch):
    simulated, real = [], PreisachModel.simulate

    def noted(self, voltage_v, memory=None):
        simulated.append(len(voltage_v))
        return real(self, voltage_v, memory)

    changed = replace(recording.model.hysteresis, offset_um=1.0)
    rows = np.arange(9)
    monkeypatch.setattr(PreisachModel, "simulate", noted)
    other = recording.with_model(replace(recording.model, hysteresis=changed))
    other.simulate((AmplifierLag(1e-3),), rows=rows)
    found = other.with_effects((AmplifierLag(1e-3),)).input_um
    assert len([count for count in simulated if count]) == 1
    model = replace(other.model, effects=(*other.model.effects, AmplifierLag(1e-3)))
    np.testing.assert_array_equal(found, other.with_model(model).input_um)


MODE, LAG = VibrationMode(9000.0, 0.01, 0.01), SensorLag(1e-4)


@pytest.mark.parametrize("effects", [
    (), (MODE,), (LAG,), (VoltageClipping(-10.0, 40.0), MODE), (MODE, Backlash(0.05)),
], ids=lambda effects: "_and_".join(effect.name for effect in effects) or "none")
def test_rows_are_those_of_the_whole_simulation(recording, effects):
    rows = np.concatenate([np.arange(20), recording.time_s.size - np.arange(9, 0, -1)])
    some_um = recording.simulate(effects, rows=rows)
    np.testing.assert_allclose(some_um, recording.simulate(effects)[rows], rtol=0.0, atol=1e-8)


def test_the_same_rows_are_simulated_once(recording):
    rows = np.arange(9)
    some_um = recording.simulate((MODE,), rows=rows)
    assert recording.simulate((MODE,), rows=rows.copy()) is some_um
    assert recording.simulate((MODE,), rows=rows + 1) is not some_um


@pytest.mark.parametrize("change", [
    lambda model: replace(model, dynamics=replace(model.dynamics, time_constant_s=6e-4)),
    lambda model: replace(model, hysteresis=replace(
        model.hysteresis, density_um_per_v2=1.1 * model.hysteresis.density_um_per_v2)),
    lambda model: replace(model, effects=(LAG,)),
    lambda model: replace(model, effects=(VoltageClipping(-10.0, 40.0), MODE)),
], ids=["dynamics", "hysteresis", "sensor", "voltage"])
def test_another_model_is_simulated_as_if_the_recording_had_been_read_for_it(
        recording, plant, play, change):
    model, effects = change(plant), (Backlash(0.05),)
    recording.simulate(effects)
    anew = simulated_recording(
        model, play(experiments.validation(arc_s=0.02, tones_s=0.2), 1), recording.past_v)
    moved = recording.with_model(model)
    assert moved.rest_um == anew.rest_um
    np.testing.assert_array_equal(moved.simulate(), anew.simulate())
    np.testing.assert_array_equal(moved.simulate(effects), anew.simulate(effects))
    np.testing.assert_array_equal(moved.drive_um, anew.drive_um)


@pytest.mark.parametrize("own, new", [
    (Backlash(0.05), sensor(0.3)),
    (AmplifierLag(2e-4), VoltageClipping(-10.0, 40.0)),
], ids=["behind", "voltage"])
def test_new_effects_follow_those_of_the_model_as_in_the_extended_model(
        recording, plant, own, new):
    beside = recording.with_model(replace(plant, effects=(own,))).simulate((new,))
    extended = recording.with_model(replace(plant, effects=(own, new))).simulate()
    np.testing.assert_array_equal(beside, extended)


def test_a_lag_that_settles_within_a_row_is_that_of_the_whole_model(plant, play):
    """The rows of a creep are 10 ms long, and those of the others are shorter than the lag."""
    slow = replace(plant, effects=(AmplifierLag(1e-4),))
    recording = play(experiments.creep(period_s=20.0), 1, stage=slow)
    beside = simulated_recording(plant, recording)
    within = beside.with_model(slow)
    np.testing.assert_array_equal(beside.simulate((AmplifierLag(1e-4),)), within.simulate())
    settled = within.settled
    apart_um = past_search.after_saturation(slow, recording).after(
        beside.past_v).fitted_um() - within.simulate()[settled]
    initial = np.exp(-np.outer(
        within.time_s[settled], [0.0, *plant.creep.poles_rad_per_s]))
    sizes = np.linalg.lstsq(initial, apart_um, rcond=None)[0]
    assert np.abs(apart_um - initial @ sizes).max() < 1e-6


def test_how_far_a_stage_had_risen_is_not_sought_for_every_model(plant, play, monkeypatch):
    """The search simulates the recording some eight times, and a fit changes its model often."""
    rising = replace(plant, first_rise=FirstRise((0.0, 60.0), (0.0, 2.0)))
    recording = simulated_recording(
        rising, play(experiments.validation(arc_s=0.02, tones_s=0.2), 1))
    monkeypatch.setattr(past_search, "after_saturation", None)
    monkeypatch.setattr(past_search, "starting_past_v", None)
    same = recording.with_model(replace(rising, hysteresis=replace(rising.hysteresis)))
    np.testing.assert_array_equal(same.simulate(), recording.simulate())


@pytest.mark.parametrize("past_v", [(95.0, 20.0), (70.0, 5.0), (60.0, 40.0), (55.0, 50.0, 52.0)])
def test_the_past_of_a_hysteresis_that_remembers_one_number_is_found(past_v):
    loops = CurvedBoucWenHysteresis(
        10.0, 20.0, growth_slope_per_v=2e-3, growth_curvature_per_v2=-1e-4, middle_v=50.0)
    model = StageModel(PreisachModel.line(0.0, 100.0, 0.2), CreepDynamics(),
                       ElectricVibrationDynamics(), effects=(loops,))
    time_s = 0.01 * np.arange(2000)
    voltage_v = 50.0 + 8.0 * np.sin(time_s)
    entering_v, _ = loops.advance(voltage_v, 0.01, loops.memory_after(past_v))
    recording = recording_of({"time_s": time_s, "voltage_v": voltage_v,
                              "displacement_um": 0.2 * entering_v})
    after = simulated_recording(model, recording)
    assert after.error_um() < 0.02 * past_search.after_saturation(model, recording).error_um()


def test_few_parts_of_rows_are_nearly_exact_and_leave_the_recording_as_it_is(plant, play):
    amplified = replace(plant, effects=(AmplifierLag(5e-5),))
    recording = simulated_recording(
        amplified, play(experiments.dynamics(duration_s=0.05), 1, stage=amplified))
    exact_um = recording.simulate()
    few_um = recording.in_few_parts().simulate()
    assert 0.0 < np.abs(few_um - exact_um).max() < 1e-3 * np.ptp(exact_um)
    np.testing.assert_array_equal(recording.simulate(), exact_um)
