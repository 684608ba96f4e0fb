# SPDX-License-Identifier: BSD-3-Clause
"""Effects that say of themselves that they do much the same as one that is found."""

from dataclasses import replace

import pytest

from piezo_identification.diagnosis.comparison.selection import in_place_of_the_found
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.effect_fit import fit_effects
from piezo_identification.fitting.regression import first_regression
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag


class Echo(SensorLag):
    """An effect of another package that does much the same as a delay, and says so."""

    name = "echo"
    confounded_with = ("delay",)


class Silent(SensorLag):
    """The same effect, but it names none."""

    name = "silent"
    confounded_with = ()


@pytest.fixture(scope="module")
def delayed(plant, play):
    experiment = experiments.validation(arc_s=0.02, tones_s=0.2)
    return play(experiment, 1, stage=replace(plant, effects=(Delay(5e-5),)))


def test_only_effects_that_name_one_of_those_found_are_tried_in_its_place(plant, delayed):
    regression = first_regression(simulate_recordings(plant, [delayed]))
    best = fit_effects(regression, (Delay(4e-5),))
    found = in_place_of_the_found(regression, [Echo, Silent], best)
    assert {name: stands_for for name, (stands_for, _) in found.items()} == {"echo": "delay"}
    assert [effect.name for effect in found["echo"][1].effects] == ["echo"]
