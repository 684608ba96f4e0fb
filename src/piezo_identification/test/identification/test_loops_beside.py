# SPDX-License-Identifier: BSD-3-Clause
"""Loops that are estimated anew from what a fitted model leaves of them."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.conditioning.outlier_samples import with_outliers_marked
from piezo_identification.conditioning.waveforms import played
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.identification.estimated_loops import (
    DensityOptions,
    estimate_hysteresis_of,
    new_loops,
)
from piezo_identification.identification.linear_dynamics import LinearDynamics
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import ElectricVibrationDynamics

pytestmark = pytest.mark.kernels

ASKED = DensityOptions(80, 1e-13, 1e-12)


def estimated_anew(plant, stage, recording):
    """Return errors (um) of loops: those of a bent model, estimated by steps, and anew."""
    recordings = {"hysteresis": with_outliers_marked(recording)}
    density = plant.hysteresis.density_um_per_v2
    bent = replace(stage, hysteresis=replace(
        plant.hysteresis,
        density_um_per_v2=density * (1.0 + np.linspace(-0.1, 0.1, len(density))[:, None])))
    near = estimate_hysteresis_of(
        recordings, LinearDynamics(stage.creep, stage.dynamics, effects=stage.effects), ASKED)
    again = new_loops(recordings, ASKED, bent, {"hysteresis": 0.0})
    voltage_v = played(recordings["hysteresis"]).voltage_v

    def error_um(hysteresis):
        return float(np.std(
            hysteresis.simulate(voltage_v) - stage.hysteresis.simulate(voltage_v)))

    return [error_um(each) for each in (bent.hysteresis, near.model(), again.model())]


def test_loops_that_are_estimated_anew_do_not_depend_on_those_of_the_model(plant, play):
    stage = replace(plant, effects=(AmplifierLag(2e-4),))
    bent_um, near_um, again_um = estimated_anew(plant, stage, play(
        experiments.hysteresis(level_count=8, harmonic_period_s=1.0), 1, 1000.0, stage=stage))
    assert again_um < 0.01 * bent_um
    assert again_um < 1.05 * near_um


def test_loops_are_found_though_a_mode_rings_over_several_rows(plant, play):
    """It rings four times in a row, so that rows show it as slow as the loops."""
    stage = replace(
        plant, dynamics=ElectricVibrationDynamics(0.0, (2.0 * np.pi * 399.5,), (0.006,)),
        effects=(VibrationMode(5000.0, 0.05, -1.0),))
    slow = replace(
        experiments.hysteresis(level_count=8, harmonic_period_s=1.0), sample_period_s=0.01)
    bent_um, near_um, again_um = estimated_anew(plant, stage, play(slow, 1, 100.0, stage=stage))
    assert again_um < 0.005 * bent_um
    assert again_um < 0.03 * near_um


def test_small_loops_are_found_in_the_recording_of_the_dynamics(plant, play):
    """Large loops show the density only where they turn, and small ones turn elsewhere."""
    random = np.random.default_rng(4)
    small_v = 40.0 + 4.0 * np.sin(0.02 * np.arange(8000)) + 2.0 * np.interp(
        np.arange(8000), np.arange(0, 8000, 200), random.uniform(-1.0, 1.0, 40))
    fast = experiments.Experiment("dynamics", small_v, 1e-3, 1, "small loops")
    recordings = {name: with_outliers_marked(play(each, number, 1000.0)) for number, (name, each)
                  in enumerate([("hysteresis", experiments.hysteresis(
                      level_count=3, harmonic_period_s=1.0)), ("dynamics", fast)])}
    loops = {"hysteresis": recordings["hysteresis"]}
    near = estimate_hysteresis_of(loops, LinearDynamics(plant.creep, plant.dynamics), ASKED)
    model = replace(plant, hysteresis=near.model())
    late_s = dict.fromkeys(recordings, 0.0)
    alone, beside = (new_loops(each, ASKED, model, late_s) for each in (loops, recordings))

    def error_um(estimate):
        errors_um = estimate.model().simulate(small_v) - plant.hysteresis.simulate(small_v)
        return float(np.std(errors_um))

    assert error_um(beside) < 0.5 * error_um(alone)
