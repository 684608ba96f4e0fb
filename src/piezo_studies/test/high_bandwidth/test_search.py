# SPDX-License-Identifier: BSD-3-Clause
"""The search for starts: the same by its seed, ever better, and of use to a tuning."""

from dataclasses import replace

import numpy as np
import pytest

from piezo_controller.feedback.sample_rate import tuned_over_stages
from piezo_controller.feedback.sample_rate.demands import Demands
from piezo_controller.feedback.sample_rate.fast_design import design_at_sample_rate
from piezo_controller.feedback.sample_rate.perturbed_loops import ModelErrors
from piezo_controller.feedback.sample_rate.tuned_over_stages import tuned_family
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_studies.high_bandwidth import search as searching
from piezo_studies.high_bandwidth.search import Search

MODEL = StageModel(PreisachModel(-20.0, 120.0, np.tril(np.full((10, 10), 5e-3))), CreepDynamics(),
                   ElectricVibrationDynamics(0.0005, (2846.0, 4909.0), (0.68535, 0.081992)))
DEMANDS = Demands(errors=ModelErrors(0.02, 0.04))


def test_a_start_begins_the_tuning_where_the_search_ended(monkeypatch):
    search = Search(MODEL, DEMANDS)
    numbers = search.drawn(np.random.default_rng(3))
    numbers[-2:] += 0.1
    monkeypatch.setattr(tuned_over_stages, "START", search.as_start(numbers))
    monkeypatch.setattr(tuned_over_stages, "RESONANCES", search.as_resonances(numbers))
    family = tuned_family(MODEL, DEMANDS, 25e-6)
    np.testing.assert_allclose(family.start, numbers, rtol=1e-12)
    assert family.structure == search.structure


@pytest.mark.long
def test_the_same_seed_finds_the_same_and_its_start_is_as_good_as_told(monkeypatch):
    for name, steps in (("START_STEPS", 12), ("FEW_STEPS", 3), ("STEPS", 6)):
        monkeypatch.setattr(searching, name, steps)
    found = []
    for _ in range(2):
        told, search = [], Search(MODEL, DEMANDS)
        margin_db = search.run(2, 1, 3, lambda what, numbers, margin_db, told=told, search=search:
                               told.append((search.as_start(numbers), margin_db)))
        assert told[-1][1] == margin_db
        assert [each for _, each in told] == sorted(each for _, each in told)
        found.append(told[-1])
    assert found[0] == found[1]
    start, margin_db = found[0]
    monkeypatch.setattr(tuned_over_stages, "START", start)
    designed = design_at_sample_rate(
        MODEL, replace(DEMANDS, worst_peak_sensitivity=4.2), effort=0.0)
    assert designed.report["margin_db"] > margin_db - 0.2
