# SPDX-License-Identifier: BSD-3-Clause
"""A comparison that Ctrl-C or its time ends, and one on other cores: what was found counts."""

from itertools import count

import numpy as np
import pytest
from made_by_scipy import logged

from piezo_common import side_by_side
from piezo_common.budget import Budget
from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.report.diagnosis_report import render_report, verdict_sentence
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

pytestmark = pytest.mark.usefixtures("likely_effects")

PERIOD_S = 1e-3


@pytest.fixture(scope="module")
def line():
    return StageModel(PreisachModel.line(0.0, 10.0, 2.0),
                      CreepDynamics(), ElectricVibrationDynamics())


@pytest.fixture(scope="module")
def recording():
    """A line with a loud hum and a sensor that bends a little: two effects in one record."""
    draw = np.random.default_rng(5)
    voltage_v = np.concatenate([[0.0], np.repeat(draw.uniform(0.0, 10.0, 150), 20)])
    size = voltage_v.size
    displacement_um = 2.0 * voltage_v
    displacement_um = displacement_um + 0.03 * ((displacement_um - 10.0) / 10.0) ** 3 * 10.0
    displacement_um += 1.5 * np.sin(2.0 * np.pi * 37.3 * PERIOD_S * np.arange(size))
    displacement_um += draw.normal(scale=2e-3, size=size)
    return logged(voltage_v, displacement_um, PERIOD_S)


def interrupted_at(beginning):
    def progress(stage, fraction):
        if stage.startswith(beginning):
            raise KeyboardInterrupt
    return progress


def test_what_was_found_before_is_kept(line, recording):
    found = diagnose(line, [recording], progress=interrupted_at("effect 2"))
    document = found.document()
    assert document["interrupted"]
    assert [effect["name"] for effect in document["effects"]] == ["periodic_disturbance"]
    assert document["after"]["rms_um"] < 0.2 * document["before"]["rms_um"]
    assert document["ceiling"] is None


def test_before_anything_is_found_the_verdict_names_nothing(line, recording):
    found = diagnose(line, [recording], progress=interrupted_at("effect 1"))
    document = found.document()
    assert document["interrupted"]
    assert (document["verdict"], document["effects"]) == ("unexplained", [])
    assert document["after"] == document["before"]
    assert found.model is line


@pytest.mark.usefixtures("without_pictures")
def test_when_the_time_is_over_the_verdict_and_its_page_say_what_was_not_tried(line, recording):
    found = diagnose(line, [recording], budget=Budget(1.0, count().__next__))
    document = found.document()
    assert document["interrupted"] and document["verdict"] == "unexplained"
    assert document["not_tried"].startswith(
        "the time of 1 s does not suffice; not tried: further effects of the new recordings")
    assert document["not_tried"] in render_report(found)
    sentence = verdict_sentence(found)
    assert "no effect compared until then explains" in sentence and "probability" not in sentence


def test_what_is_found_is_the_same_on_any_number_of_cores(line, recording, monkeypatch):
    documents = []
    for cores in (1, 3):
        monkeypatch.setattr(side_by_side, "cores", lambda cores=cores: cores)
        found = diagnose(line, [recording], progress=interrupted_at("effect 2"))
        documents.append(found.document())
    assert documents[0] == documents[1]
