# SPDX-License-Identifier: BSD-3-Clause
"""Which of a model's own parameters a stage has changed."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.monitoring.changed_parameters import (
    changed_parameters,
    parameter_groups,
)
from piezo_recorder.reading.memory import recording_of

PERIOD_S = 1e-4
NOISE_UM = 0.009


def recorded(stage, seed=0, seconds=1.0):
    time_s = PERIOD_S * np.arange(round(seconds / PERIOD_S))
    voltage_v = 50.0 - 30.0 * np.cos(2 * np.pi * 5.0 * time_s) + sum(
        2.0 * np.sin(2 * np.pi * hz * time_s) for hz in (170.0, 430.0, 790.0))
    noise_um = NOISE_UM * np.random.default_rng(seed).normal(size=time_s.size)
    return recording_of({
        "time_s": time_s, "voltage_v": voltage_v,
        "displacement_um": stage.simulate(voltage_v, PERIOD_S) + noise_um})


def with_dynamics(model, **changes):
    return replace(model, dynamics=replace(model.dynamics, **changes))


def moved(model, index, frequency=1.0, damping=1.0):
    frequencies, dampings = map(list, (
        model.dynamics.mode_frequencies_rad_per_s, model.dynamics.damping_ratios))
    frequencies[index] *= frequency
    dampings[index] *= damping
    return with_dynamics(model, mode_frequencies_rad_per_s=tuple(frequencies),
                         damping_ratios=tuple(dampings))


def test_a_stage_that_stays_as_it_was_has_changed_nothing(plant):
    found = changed_parameters(plant, recorded(plant))
    assert found.changes == {} and found.model is plant
    assert found.after_rms_um == found.before_rms_um == pytest.approx(NOISE_UM, rel=0.05)
    assert found.sentence == "no parameter of the model explains the change"


@pytest.mark.parametrize("index", [0, 1])
def test_a_mode_that_moved_is_told_from_the_other(plant, index):
    found = changed_parameters(plant, recorded(moved(plant, index, 1.03, 0.97)))
    before, after = found.changes[f"mode_{index + 1}_frequency_rad_per_s"]
    assert before == plant.dynamics.mode_frequencies_rad_per_s[index]
    assert after / before == pytest.approx(1.03, abs=2e-3)
    assert found.after_rms_um == pytest.approx(NOISE_UM, rel=0.05)
    assert f"mode_{index + 1}_frequency_rad_per_s from {before:.6g}" in found.sentence
    truth = moved(plant, index, 1.03, 0.97).dynamics.mode_frequencies_rad_per_s
    assert found.model.dynamics.mode_frequencies_rad_per_s == pytest.approx(truth, rel=5e-3)


def test_a_spring_that_takes_motion_is_a_change_of_gain(plant):
    weaker = replace(plant, hysteresis=replace(
        plant.hysteresis, density_um_per_v2=0.98 * plant.hysteresis.density_um_per_v2,
        reversible_um_per_v=0.98 * plant.hysteresis.reversible_um_per_v))
    found = changed_parameters(plant, recorded(weaker))
    before, after = found.changes["gain_um_per_v"]
    assert after / before == pytest.approx(0.98, abs=1e-3)


def test_what_the_model_has_no_number_for_is_not_explained(plant):
    recording = recorded(plant)
    bent = replace(recording, displacement_um=recording.displacement_um
                   + 0.2 * np.sin(2 * np.pi * 61.0 * recording.time_s))
    found = changed_parameters(plant, bent)
    assert found.after_rms_um > 0.9 * found.before_rms_um


def test_a_model_without_a_lag_has_none_that_changes(plant):
    assert set(parameter_groups(plant)) == {"gain", "lag", "mode 1", "mode 2"}
    assert "lag" not in parameter_groups(with_dynamics(plant, time_constant_s=0.0))
