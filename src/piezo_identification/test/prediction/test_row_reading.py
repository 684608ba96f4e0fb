# SPDX-License-Identifier: BSD-3-Clause
"""Rows of further recordings, read as those that a model was identified from."""

from dataclasses import replace

import numpy as np
import pytest
from made_by_scipy import logged
from scipy.signal import cont2discrete, lfilter

from piezo_identification.prediction.row_reading import (
    all_as_identified,
    predict_as_identified,
    read_as_identified,
)
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

PERIOD_S = 1e-3
FINE = 10
"""Instants of a sample period at which the displacement is known."""

LAG_S = 4e-3


def recorded(read_at_samples):
    """A line with a lag, by a filter at ten times the rate, read by a logger of some habit."""
    voltage_v = np.repeat(np.random.default_rng(3).uniform(0.0, 10.0, 4000), FINE)
    fine_s = PERIOD_S / FINE
    (b,), a, _ = cont2discrete(([1.0], [LAG_S, 1.0]), fine_s, "zoh")
    displacement_um = 2.0 * lfilter(b, a, voltage_v)
    instants = np.arange(0, voltage_v.size - 2 * FINE, FINE)
    read = displacement_um[instants + round(read_at_samples * FINE)]
    return logged(voltage_v[instants], read, PERIOD_S, "logger")


def identified(read_at_samples):
    line = PreisachModel.line(0.0, 10.0, 2.0)
    model = StageModel(line, CreepDynamics(), ElectricVibrationDynamics(LAG_S))
    rows = {"dynamics": {"read_at_samples": read_at_samples, "delay_s": 0.0,
                         "standard_deviation_s": 0.0}}
    return IdentifiedModel(model, (0.0, 10.0), rows=rows)


@pytest.mark.parametrize("read_at_samples", [0.5, 1.0])
def test_rows_of_the_same_logger_are_aligned_and_those_of_another_one_are_not(read_at_samples):
    of_model = identified(read_at_samples)
    same, found = read_as_identified(of_model, recorded(read_at_samples))
    assert found == read_at_samples
    assert same.sample_index[0] == 1
    other = recorded(0.0)
    kept, found = read_as_identified(of_model, other)
    assert found == 0.0
    assert kept is other


def test_a_model_without_a_habit_leaves_rows_as_they_are():
    recording = recorded(1.0)
    for model in (identified(0.0), replace(identified(0.0), rows={})):
        assert read_as_identified(model, recording) == (recording, 0.0)


def test_commands_and_python_read_rows_as_identified_unless_it_was_said_how():
    of_model, recording = identified(1.0), recorded(1.0)
    prediction, sentences = predict_as_identified(of_model, recording)
    assert len(sentences) == 1 and "read 1 sample periods after" in sentences[0]
    said, sentences = predict_as_identified(of_model, recording, 1.0)
    assert sentences == [] and said.e_y_percent() == pytest.approx(prediction.e_y_percent())
    bare, sentences = predict_as_identified(of_model.model, recording)
    assert sentences == [] and bare.e_y_percent() > 5.0 * prediction.e_y_percent()
    (kept,), sentences = all_as_identified(of_model.model, [recording])
    assert sentences == [] and kept is recording


def test_a_sign_that_a_simulation_changed_is_said():
    upright = recorded(0.0)
    prediction, sentences = predict_as_identified(
        identified(0.0), replace(upright, displacement_um=-upright.displacement_um))
    assert prediction.reversed and prediction.e_y_percent() < 1.0
    assert len(sentences) == 1 and "its sign is changed" in sentences[0]


@pytest.mark.parametrize("factor", [0.05, 20.0])
def test_a_travel_of_other_units_is_asked_about(factor):
    monitored = recorded(0.0)
    _, sentences = predict_as_identified(
        identified(0.0), replace(monitored, displacement_um=factor * monitored.displacement_um))
    assert len(sentences) == 1 and "in the units of the identification?" in sentences[0]


def test_the_longest_stretch_between_gaps_is_simulated_and_said():
    whole = recorded(0.0)
    kept = np.r_[0:1200, 1300:3300, 3400:whole.voltage_v.size]
    rows = whole.select(np.isin(np.arange(whole.voltage_v.size), kept))
    with_gaps = replace(rows, gaps=[(1200, 100), (3300, 100)])
    prediction, sentences = predict_as_identified(identified(0.0), with_gaps)
    assert len(sentences) == 1 and "has 2 gaps" in sentences[0] and "2000 of" in sentences[0]
    assert prediction.e_y_percent() < 1.0
    assert prediction.sample_index[0] >= 1300 and prediction.sample_index[-1] < 3300
