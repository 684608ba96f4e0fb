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

pytestmark = pytest.mark.kernels

ASKED = DensityOptions(80, 1e-13, 1e-12)


def test_loops_that_are_estimated_anew_do_not_depend_on_those_of_the_model(plant, play):
    stage = replace(plant, effects=(AmplifierLag(2e-4),))
    recordings = {"hysteresis": with_outliers_marked(play(
        experiments.hysteresis(level_count=8, harmonic_period_s=1.0), 1, 1000.0, stage=stage))}
    density = plant.hysteresis.density_um_per_v2
    bent = replace(stage, hysteresis=replace(
        plant.hysteresis,
        density_um_per_v2=density * (1.0 + np.linspace(-0.1, 0.1, len(density))[:, None])))
    near = estimate_hysteresis_of(
        recordings, LinearDynamics(stage.creep, stage.dynamics, effects=stage.effects), ASKED)
    again = new_loops(recordings, ASKED, near, bent, {"hysteresis": 0.0})
    voltage_v = played(recordings["hysteresis"]).voltage_v

    def error_um(hysteresis):
        return float(np.std(
            hysteresis.simulate(voltage_v) - stage.hysteresis.simulate(voltage_v)))

    assert error_um(again.model()) < 0.01 * error_um(bent.hysteresis)
    assert error_um(again.model()) < 1.05 * error_um(near.model())
