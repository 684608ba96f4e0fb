# SPDX-License-Identifier: BSD-3-Clause
"""What a learner predicts of a residual is set against what was put into it."""

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from piezo_identification.diagnosis.evidence import ceiling as module
from piezo_identification.diagnosis.evidence.ceiling import ceiling
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.regression import (
    first_regression,
    with_fixed_parameters,
)


@pytest.fixture(scope="module")
def recorded(plant, play):
    return play(experiments.validation(arc_s=0.02, tones_s=0.08), 1)


@pytest.fixture(scope="module")
def ceiling_beside(plant, recorded):
    """Add a signal to the displacement, and ask how much of what the model leaves repeats."""
    def of(added_um):
        part = replace(recorded, displacement_um=recorded.displacement_um + added_um)
        regression = with_fixed_parameters(
            first_regression(simulate_recordings(plant, [part])), ())
        return ceiling(regression, regression.fit(()))

    return of


@pytest.mark.long
def test_noise_that_grows_with_the_voltage_cannot_be_predicted(ceiling_beside, recorded):
    """Its size repeats, but not its values."""
    draw = np.random.default_rng(5).normal(size=recorded.time_s.size)
    found = ceiling_beside(0.03 * draw * np.abs(recorded.voltage_v / recorded.voltage_v.max()))
    assert found.predictable_um == 0.0
    assert found.random_um == found.left_um > 0.009
    assert found.sentence().startswith("No learner predicts any of the residual")


def test_what_follows_from_the_voltage_is_predicted_from_the_voltage(
        ceiling_beside, recorded, monkeypatch):
    monkeypatch.setattr(module, "SETTINGS", replace(module.SETTINGS, trees=20))
    added_um = 0.03 * np.sin(0.2 * recorded.voltage_v)
    found = ceiling_beside(added_um)
    assert found.from_voltage_um > 0.85 * np.sqrt(found.left_um**2 - 0.009**2)
    assert found.random_um < 1.3 * 0.009


@pytest.mark.long
def test_hum_is_predicted_from_the_past_and_not_from_the_voltage(ceiling_beside, recorded):
    added_um = 0.03 * np.sin(2.0 * np.pi * 333.3 * recorded.time_s)
    found = ceiling_beside(added_um)
    assert found.predictable_um == pytest.approx(added_um.std(), rel=0.1)
    assert found.from_voltage_um < 0.5 * found.predictable_um
    assert np.hypot(found.predictable_um, found.random_um) == pytest.approx(found.left_um)


def test_a_learner_takes_one_thread_beside_the_other(ceiling_beside, monkeypatch):
    taken = []

    def learn_nothing(regression, fit, features):
        taken.extend(library["num_threads"] for library in threadpool_info())
        return fit.residual

    monkeypatch.setattr(module, "_unpredicted", learn_nothing)
    ceiling_beside(0.0)
    assert set(taken) == {1}
