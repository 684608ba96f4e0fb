# SPDX-License-Identifier: BSD-3-Clause
"""Which sets of effects are alternatives to each other."""

from types import SimpleNamespace

import pytest

from piezo_identification.diagnosis.experiment_design.alternative_explanations import (
    find_alternatives,
    without_idle,
)
from piezo_identification.experiments import catalogue as experiments
from piezo_identification.fitting.dataset import simulate_recordings
from piezo_identification.fitting.regression import first_regression
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag

LAG = SensorLag(5e-5)


@pytest.fixture(scope="module")
def regression(plant, play):
    recording = play(experiments.validation(arc_s=0.02, tones_s=0.2), 1)
    return first_regression(simulate_recordings(plant, [recording]))


@pytest.mark.parametrize(("delay_s", "remaining"), [
    (0.0, ["sensor_lag"]), (1e-5, ["delay+sensor_lag", "sensor_lag"])])
def test_a_set_with_an_effect_that_changes_nothing_is_the_set_without_it(
        regression, delay_s, remaining):
    fits = {name: SimpleNamespace(effects=effects, regression=regression) for name, effects in (
        ("delay+sensor_lag", (LAG, Delay(delay_s))), ("sensor_lag", (LAG,)))}
    assert list(without_idle(fits, 0)) == remaining
    # Where the smaller set did not compete, the larger one stands for it.
    alone = {"delay+sensor_lag": fits["delay+sensor_lag"]}
    assert without_idle(alone, 0) == alone


def test_the_model_alone_is_left_where_no_stage_can_have_what_was_found(regression, monkeypatch):
    monkeypatch.setattr(SensorLag, "impossible", lambda self, extent: "too slow for any sensor")
    entry = {"name": "sensor_lag", "came": "not asked", "parameters": {"time_constant_s": 5e-5}}
    found = find_alternatives(regression, {"effects": [entry]})
    assert found.probabilities == {"none": 1.0}
