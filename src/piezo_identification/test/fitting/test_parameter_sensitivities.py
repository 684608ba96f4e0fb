# SPDX-License-Identifier: BSD-3-Clause
"""Changes of a model: what a sensitivity promises, and what a change must leave as it is."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.fitting.free_parameters import changed_model, free_sensitivities
from piezo_identification.fitting.parameter_sensitivities import (
    WIDTHS,
    parameter_sensitivities,
    perturbed,
)
from piezo_identification.simulation.past_search import simulated_recording
from piezo_identification.simulation.sampled_response import SampledSystem
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

PERIOD_S, SAMPLES = 1e-3, 800
NEAR = len(WIDTHS.near_diagonal)


def stage(density_um_per_v2, reversible_um_per_v=0.4):
    size = len(density_um_per_v2)
    return StageModel(
        PreisachModel(0.0, 100.0, density_um_per_v2, 0.0, np.full(size, reversible_um_per_v)),
        CreepDynamics(), ElectricVibrationDynamics(1e-3))


def simulated(model):
    voltage_v = 50.0 - 45.0 * np.cos(2.0 * np.pi * 3.0 * PERIOD_S * np.arange(SAMPLES))
    return simulated_recording(model, Recording(
        path="", sample_rate_hz=1.0 / PERIOD_S, sample_index=np.arange(SAMPLES),
        sample_periods_s=np.full(SAMPLES, PERIOD_S), voltage_v=voltage_v,
        displacement_um=np.zeros(SAMPLES), flags=np.full(SAMPLES, Flag.PLAYING, dtype=np.uint32)),
        ())


@pytest.mark.parametrize(("zero", "change", "changed"), [
    (0.7, 3.0, 0.4534), (0.7, 9.0, 0.35), (3.0, -9.0, 1.3306)])
def test_creep_of_either_sign_keeps_its_zero_in_the_left_half_plane(zero, change, changed):
    model = replace(stage(np.tril(np.full((4, 4), 1e-3))), creep=CreepDynamics((1.0,), (zero,)))
    changes = np.zeros(free_sensitivities(simulated(model), np.arange(2)).shape[1])
    changes[1] = change
    zeros = changed_model(model, changes).creep.zeros_rad_per_s
    np.testing.assert_allclose(zeros, changed, atol=1e-4)


def test_every_sensitivity_is_the_slope_of_the_changed_model():
    model = stage(np.tril(np.full((12, 12), 1e-3)))
    columns = parameter_sensitivities(simulated(model), np.arange(SAMPLES))
    step = 1e-4
    for number, column in enumerate(columns.T):
        ends_um = [simulated(perturbed(model, sign * np.eye(columns.shape[1])[number])).simulate()
                   for sign in (step, -step)]
        slope_um = (ends_um[0] - ends_um[1]) / (2.0 * step)
        slope_um -= slope_um[0] - column[0]
        assert slope_um == pytest.approx(column, abs=1e-3 * np.abs(column).max() + 1e-9)


@pytest.mark.parametrize("sensitivities", [parameter_sensitivities, free_sensitivities])
def test_parameters_of_the_linear_part_share_its_simulation(monkeypatch, sensitivities):
    poles = tuple(10.0 ** np.arange(-4.0, 3.0))
    part = simulated(replace(
        stage(np.tril(np.full((4, 4), 1e-3))),
        creep=CreepDynamics(poles, tuple(1.02 * pole for pole in poles)),
        dynamics=ElectricVibrationDynamics(1e-3, (400.0, 700.0), (0.02, 0.02))))
    passes, real = [], SampledSystem.response_at

    def noted(self, input_um, at):
        passes.append(input_um is part.input_um)
        return real(self, input_um, at)

    monkeypatch.setattr(SampledSystem, "response_at", noted)
    assert sensitivities(part, np.arange(9)).shape[1] > 19
    assert sum(passes) <= 2


def test_errors_about_the_diagonal_are_none_of_a_line():
    """They were a gain that no prior bounds, and a line has no density to be wrong."""
    line = stage(np.zeros((1, 1)))
    columns = parameter_sensitivities(simulated(line), np.arange(SAMPLES))
    assert np.all(columns[:, -1 - NEAR : -1] == 0.0)
    changes = np.zeros(columns.shape[1])
    changes[-1 - NEAR : -1] = 3.0
    assert perturbed(line, changes).hysteresis.reversible_um_per_v == pytest.approx([0.4])
