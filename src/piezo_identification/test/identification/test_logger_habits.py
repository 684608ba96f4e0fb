# SPDX-License-Identifier: BSD-3-Clause
"""What is the logger's and what is the stage's, from the recordings of a stage of another form."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))
from independent_stage import IndependentStage, square_wave_v

from piezo_identification.conditioning.settling import low_frequency_delay_s
from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
from piezo_identification.identification.given_data import aligned
from piezo_identification.identification.identify import identify, validation_errors
from piezo_identification.identification.linear_dynamics import LinearDynamics
from piezo_identification.identification.row_delays import validation_as_read
from piezo_models.cascade import StageModel
from piezo_models.effects.delay import Delay
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import load_model, save_model

FAST_S, SLOW_S = 1e-4, 5e-3
MODES = ((2846.0, 0.3, 0.7), (4909.0, 0.082, 0.3))
NOISE_UM = 0.005


@pytest.fixture
def recordings(tmp_path):
    """Recordings of the dynamics and the hysteresis, each in a file of its own."""
    def of(stage):
        time_s = np.arange(round(1.0 / SLOW_S)) * SLOW_S
        loops_v = np.concatenate([
            -20.0 + 0.5 * (top_v + 20.0) * (1.0 - np.cos(2.0 * np.pi * time_s))
            for top_v in np.linspace(-13.0, 120.0, 20)])
        made = {"dynamics": stage.record(square_wave_v(sample_period_s=FAST_S), FAST_S, NOISE_UM),
                "hysteresis": stage.record(loops_v, SLOW_S, NOISE_UM, 2)}
        for name in made:
            (tmp_path / name).write_text(name)
        return {name: replace(recording, path=str(tmp_path / name))
                for name, recording in made.items()}

    return of


def modes_of(model):
    """Frequency, damping ratio and part of each mode of a model with one in series."""
    parallel = [effect for effect in model.effects if isinstance(effect, VibrationMode)]
    dynamics = model.dynamics
    assert dynamics.antiresonance_frequencies_rad_per_s == ()
    (frequency,), (damping,) = dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios
    return sorted([
        (frequency, damping, 1.0 - sum(mode.participation for mode in parallel)),
        *((mode.frequency_rad_per_s, mode.damping_ratio, mode.participation)
          for mode in parallel)])


@pytest.mark.long
def test_rows_read_at_the_end_of_the_hold_do_not_enter_the_model(recordings, tmp_path):
    stage = IndependentStage(4.9e-4, MODES, read_at=1.0)
    told = []
    identified = identify(**recordings(stage), note=told.append)
    assert not any(isinstance(effect, Delay) for effect in identified.model.effects)
    np.testing.assert_allclose(modes_of(identified.model), MODES, rtol=1e-3)
    assert identified.model.dynamics.time_constant_s == pytest.approx(4.9e-4, rel=1e-3)
    assert {name: row["read_at_samples"] for name, row in identified.rows.items()} == {
        "dynamics": pytest.approx(1.0, abs=5e-4), "hysteresis": pytest.approx(1.0, abs=1e-5)}
    assert any("rows of the dynamics: read 1 sample periods after" in text for text in told)
    save_model(tmp_path / "model.json", identified)
    kept = load_model(tmp_path / "model.json").rows
    assert {name: pytest.approx(row) for name, row in identified.rows.items()} == kept


@pytest.mark.long
def test_a_delay_behind_rows_said_to_be_read_late_is_the_stages(recordings, tmp_path):
    stage = IndependentStage(4.9e-4, MODES, read_at=1.0, delay_s=2.5e-4)
    identified = identify(**recordings(stage), read_at_samples=1.0)
    *modes, delay = identified.model.effects
    assert [type(mode) for mode in modes] == [VibrationMode] and delay.name == "delay"
    np.testing.assert_allclose(modes_of(identified.model), MODES, rtol=1e-3)
    assert delay.delay_s == pytest.approx(2.5e-4, abs=5e-7)
    deviations = identified.uncertainties["effects"]
    assert [set(each) for each in deviations] == [
        {"frequency_rad_per_s", "damping_ratio", "participation"}, {"delay_s"}]
    assert 0.0 < deviations[-1]["delay_s"] < 5e-7
    assert identified.rows["hysteresis"]["read_at_samples"] == 1.0
    save_model(tmp_path / "model.json", identified)
    assert load_model(tmp_path / "model.json").uncertainties["effects"] == [
        pytest.approx(each) for each in deviations]


@pytest.mark.parametrize(("hidden", "read_at_samples", "delay_s"), [
    ({"read_at": 1.0}, 1.0, 0.0),
    pytest.param({"delay_s": 2.5e-4}, 0.0, 2.5e-4, marks=pytest.mark.long)])
def test_what_comes_early_is_the_loggers_and_what_comes_late_the_stages(
        hidden, read_at_samples, delay_s):
    stage = IndependentStage(4.9e-4, ((2846.0, 0.3, 1.0),), **hidden)
    found = LinearDynamics().with_dynamics(estimate_dynamics(
        stage.record(square_wave_v(sample_period_s=FAST_S), FAST_S, NOISE_UM), CreepDynamics(), 1))
    assert found.read_at_samples == pytest.approx(read_at_samples, abs=0.02)
    assert found.delay_s == pytest.approx(delay_s, abs=0.02 * FAST_S)
    assert len(found.all_effects) == len(found.effect_deviations)
    assert any(isinstance(effect, Delay) for effect in found.all_effects) == bool(delay_s)


@pytest.mark.parametrize("read_at", [0.0, 1.0])
def test_a_validation_of_another_logger_is_read_as_it_was(read_at):
    """The rows of the dynamics were read late; those of the validation were, or were not."""
    stage = IndependentStage(
        4.9e-4, MODES, read_at=read_at, gains_um_per_v=(0.5,), half_widths_v=(0.0,))
    time_s = np.arange(4000) * 1e-3
    unseen = stage.record(50.0 + 25.0 * np.sin(2.0 * np.pi * 17.0 * time_s), 1e-3, NOISE_UM)
    modes = tuple(VibrationMode(*mode) for mode in MODES)
    line = PreisachModel(20.0, 80.0, np.zeros((1, 1)), 10.0, np.array([0.5]))
    model = StageModel(line, CreepDynamics(), ElectricVibrationDynamics(4.9e-4), effects=modes)
    late = {"validation": 1.0}
    recordings, instants = validation_as_read(
        model, {"validation": unseen}, aligned({"validation": unseen}, late), late)
    assert instants == {"validation": read_at}
    assert validation_errors(model, recordings)["e_y_percent"] < 0.2


@pytest.mark.long
def test_effects_stand_in_the_order_of_the_signal_with_their_deviations():
    stage = IndependentStage(
        3e-4, ((3200.0, 0.5, 0.85), (5400.0, 0.025, 0.19), (8300.0, 0.015, -0.04)), delay_s=1e-4)
    estimate = estimate_dynamics(
        stage.record(square_wave_v(periods=30), 25e-6, NOISE_UM), CreepDynamics())
    found = LinearDynamics().with_dynamics(estimate)
    assert [effect.name for effect in found.all_effects] == ["vibration_mode"] * 2 + ["delay"]
    for effect, deviations in zip(found.all_effects, found.effect_deviations, strict=True):
        assert set(deviations) <= set(effect.parameters())
    whole_s = 3e-4 + 1e-4 + sum(2.0 * damping * part / w for w, damping, part in stage.modes)
    assert low_frequency_delay_s(found.slow_dynamics) + found.slow_delay_s == pytest.approx(
        whole_s, rel=2e-3)
    assert len(found.slow_dynamics.damping_ratios) + len(found.slow_dynamics.parallel_modes) == 3
