# SPDX-License-Identifier: BSD-3-Clause
import numpy as np
import pytest

from piezo_identification.estimators.dynamics.fast_estimate import estimate_dynamics
from piezo_identification.experiments import catalogue as experiments
from piezo_models.hysteresis.preisach import PreisachModel


@pytest.fixture(scope="module")
def recording(play):
    return play(experiments.multisine(tones_s=0.4), 1)


@pytest.mark.parametrize("mode_count", [2, pytest.param(None, marks=pytest.mark.long)])
def test_six_tones_and_the_hysteresis_give_lag_and_both_modes(plant, recording, mode_count):
    estimate = estimate_dynamics(
        recording, plant.creep, mode_count, hysteresis=plant.hysteresis)
    assert str(estimate.order) == "2"
    assert estimate.model.time_constant_s == pytest.approx(0.00049, rel=1e-3)
    assert estimate.model.mode_frequencies_rad_per_s == pytest.approx((2846.0, 4909.0), rel=1e-3)
    assert estimate.model.damping_ratios == pytest.approx((0.685, 0.082), rel=2e-3)
    assert estimate.residual_rms == pytest.approx(0.009, rel=0.05)


@pytest.mark.long
def test_without_the_hysteresis_as_input_the_modes_are_off(plant, recording):
    """What makes the identified hysteresis worth its trouble."""
    line = PreisachModel(-20.0, 120.0, np.diag(np.ones(140)), -9.0)
    estimate = estimate_dynamics(recording, plant.creep, 2, 0.0, hysteresis=line)
    assert estimate.model.damping_ratios[0] != pytest.approx(0.685, rel=0.02)


def test_a_recording_beyond_the_known_hysteresis_is_refused(plant, recording):
    narrow = PreisachModel(0.0, 50.0, np.tril(np.ones((10, 10))), 0.0)
    with pytest.raises(ValueError, match="known from 0 to 50 V: identify it over a wider range"):
        estimate_dynamics(recording, plant.creep, hysteresis=narrow)
