# SPDX-License-Identifier: BSD-3-Clause
"""Recordings whose loops have other slopes, fitted together behind a line."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.fitting.whole_model import WholeModel
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder import recording_of

NOISE_UM = 1e-3
MODE = 2.0 * np.pi * 90.0


def stage(um_per_v, frequency_rad_per_s=MODE):
    return StageModel(
        PreisachModel.line(0.0, 60.0, um_per_v), CreepDynamics((0.5,), (0.53,)),
        ElectricVibrationDynamics(), effects=(VibrationMode(frequency_rad_per_s, 0.03, 0.8),))


def recorded(model, voltage_v, period_s, seed):
    recording = recording_of({
        "time_s": period_s * np.arange(voltage_v.size), "voltage_v": voltage_v,
        "displacement_um": model.simulate(voltage_v, period_s)})
    noise_um = np.random.default_rng(seed).normal(scale=NOISE_UM, size=voltage_v.size)
    return replace(recording, displacement_um=recording.displacement_um + noise_um)


@pytest.fixture(scope="module")
def recordings():
    wide = recorded(stage(0.11), np.where(np.arange(3000) // 500 % 2, 60.0, 0.0), 0.05, 1)
    narrow = recorded(stage(0.10), np.where(np.arange(3000) // 100 % 2, 35.0, 25.0), 1e-3, 2)
    return [wide, narrow]


def residuals_um(fit):
    return [np.std(np.concatenate(parts)) for parts in fit.residual_um]


def test_each_recording_has_its_gain_and_the_model_that_of_the_widest(recordings):
    given = stage(0.105, 1.01 * MODE)
    problem = WholeModel(given, recordings, [0.0, 0.0], has_free_gains=True)
    fit = problem.fit(given, None, 12)
    assert residuals_um(fit) == pytest.approx([NOISE_UM, NOISE_UM], rel=0.05)
    (mode,) = fit.model.effects
    assert mode.frequency_rad_per_s == pytest.approx(MODE, rel=1e-4)
    assert mode.participation == pytest.approx(0.8, rel=1e-3)
    last = problem.with_held_out_rows(fit).fit(fit.model, None, 12)
    assert residuals_um(last) == pytest.approx([NOISE_UM, NOISE_UM], rel=0.05)
    wide = SimulatedRecording(fit.model, recordings[0])
    assert np.ptp(wide.simulate()) == pytest.approx(np.ptp(recordings[0].displacement_um), rel=2e-3)


def test_one_gain_does_not_explain_both(recordings):
    given = stage(0.105)
    problem = WholeModel(given, recordings, [0.0, 0.0])
    assert max(residuals_um(problem.fit(given, None, 12))) > 5.0 * NOISE_UM
