# SPDX-License-Identifier: BSD-3-Clause
"""Effects that resemble each other, decided by recordings that are proposed and played."""

import numpy as np
import pytest

from piezo_identification.diagnosis.experiment_design.decide import decide
from piezo_identification.experiments.catalogue import Experiment
from piezo_studies.diagnosis_benchmark import records, twin_decisions
from piezo_studies.diagnosis_benchmark.plants import draw_plant
from piezo_studies.diagnosis_benchmark.run_case import clean_model


def test_held_values_are_measured_as_means_at_the_clock():
    plant = draw_plant((77, 0))
    held = Experiment("held", np.repeat([20.0, 40.0], 5), 1e-3, 1, "")
    recording = records.play_proposed(plant, held, 1)
    assert recording.sample_rate_hz == records.STAGE_LIMITS.sample_rate_hz
    assert set(np.diff(recording.sample_index)) == {40}
    assert recording.playing.sum() == 10


@pytest.mark.long
def test_one_recording_decides():
    cause = "sensor_lag"
    result = twin_decisions.decide_twin(cause, clean_model(77, 0), (77, 0), 1)
    first, *_, last = result["steps"]
    assert not first["is_decided"] and first["proposed"]["duration_s"] <= 30.0
    assert last["is_decided"]
    assert last["effects"][0] == cause
    assert last["probabilities"][cause] >= 0.95


def test_a_diagnosis_without_alternatives_asks_for_nothing(monkeypatch):
    played, told = [], []
    model = object()
    module = "piezo_identification.diagnosis.experiment_design.decide."

    class Found:
        selection = type("Selection", (), {"regression": None})
        stated_um = 0.0

        def document(self):
            return {}

    class Alone:
        alternatives = ()

        def __init__(self, chances):
            self.probabilities = chances

    monkeypatch.setattr(module + "diagnose", lambda *_: Found())
    monkeypatch.setattr(module + "old_recordings", lambda *_: [])
    monkeypatch.setattr(module + "decided_verdict", lambda *given: given[-2])
    monkeypatch.setattr(module + "propose", lambda *_: "proposal")
    for chances, budget, count in (({"delay": 1.0}, 3, 0), ({"a": 0.5, "b": 0.5}, 2, 2),
                                   ({"a": 0.5, "b": 0.5}, 0, 0)):
        played.clear()
        told.clear()
        monkeypatch.setattr(module + "find_alternatives", lambda *_, c=chances: Alone(c))
        steps = decide(model, [], lambda proposal, report: played.append(proposal), budget,
                       progress=lambda what, fraction: told.append(fraction))
        assert played == ["proposal"] * count and len(steps) == count + 1
        assert told == sorted(told) and 0.0 <= told[0] and told[-1] <= 1.0
        assert steps[-1].proposal is None
        assert steps[-1].is_decided == (max(chances.values()) >= 0.95)
