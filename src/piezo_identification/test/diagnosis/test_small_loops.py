# SPDX-License-Identifier: BSD-3-Clause
"""Loops over small spans are what an identification knows least: their errors are no effect."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.experiments.catalogue import Experiment
from piezo_models.effects.backlash import Backlash

PERIOD_S = 1e-3


@pytest.fixture(scope="module")
def record(plant, play):
    """Play tones of many turns over a few volts, on a stage with some effects."""
    time_s = np.arange(5000) * PERIOD_S
    orders = np.array([2, 5, 11, 23, 47, 101])
    phases = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, orders.size)
    tones = np.cos(2.0 * np.pi * np.outer(time_s / 5.0, orders) + phases) @ orders**-0.5
    experiment = Experiment("tones", 50.0 + 25.0 * tones / np.abs(tones).max(), PERIOD_S, 1, "")

    def record_with(*effects):
        return play(experiment, 1, stage=replace(plant, effects=effects))

    return record_with


def less_near_the_diagonal(plant):
    """Return a model whose density is a fifth too small on its diagonal, less so 1 V beside it."""
    density = plant.hysteresis.density_um_per_v2
    rising, falling = np.indices(density.shape)
    span_v = (rising - falling) * 140.0 / len(density)
    return replace(plant, hysteresis=replace(
        plant.hysteresis, density_um_per_v2=density * (1.0 - 0.2 * np.exp(-span_v / 1.0))))


def test_a_density_that_is_wrong_at_small_spans_is_no_effect(plant, record):
    diagnosis = diagnose(less_near_the_diagonal(plant), [record()])
    assert (diagnosis.verdict, diagnosis.effects) == ("none", [])
    assert diagnosis.before["rms_um"] > 1.5 * diagnosis.noise_floor_um


@pytest.mark.long
def test_a_play_is_named_beside_such_a_density(plant, record):
    diagnosis = diagnose(less_near_the_diagonal(plant), [record(Backlash(0.4))])
    assert [each["name"] for each in diagnosis.effects] == ["backlash"]
    assert diagnosis.effects[0]["parameters"]["width_um"] == pytest.approx(0.4, rel=0.1)
