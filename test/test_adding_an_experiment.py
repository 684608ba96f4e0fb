# SPDX-License-Identifier: BSD-3-Clause
"""The experiment of docs/adding_an_experiment.md, installed from outside, runs like any other."""

import json
import os
import sys

import numpy as np
import pytest

from piezo_client.client import GoalFailed
from piezo_client.stage import Stage
from piezo_identification.experiments.catalogue import StageLimits, named_experiment
from piezo_recorder.reading.reader import read_recording


@pytest.fixture
def outside(package_of_page, monkeypatch):
    """The package of the page, installed for this process and for those it starts."""
    directory = package_of_page("adding_an_experiment.md")
    monkeypatch.syspath_prepend(directory)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(directory), *sys.path]))
    yield directory
    sys.modules.pop("swept_sine", None)


def rewrite(directory, old, new):
    module = directory / "swept_sine.py"
    text = module.read_text()
    assert old in text
    module.write_text(text.replace(old, new))


def test_experiment_from_outside_is_found_by_its_name(outside):
    experiment = named_experiment("swept_sine")
    assert experiment.duration_s == pytest.approx(2.0)
    assert experiment.voltage_v[0] == StageLimits().middle_v
    assert np.ptp(experiment.voltage_v) == pytest.approx(14.0, rel=1e-3)
    # The mean frequency of the first and of the last tenth, from the crossings of the middle.
    crossings = np.diff(np.signbit(experiment.voltage_v - 50.0)).astype(int)
    assert crossings[:8000].sum() < 4
    assert crossings[-8000:].sum() == pytest.approx(2 * 0.2 * 780.0, rel=0.05)


@pytest.mark.parametrize(("old", "new", "message"), [
    ("AMPLITUDE = 0.05", "AMPLITUDE = 0.6", "the stage allows -20..120 V"),
    ('"swept_sine", voltage_v', '"sweep", voltage_v', "let it return an Experiment of this name"),
    ("return Experiment(", "return (lambda *given, **named: None)(", "makes something else"),
    ("voltage_v, 1.0 /", "voltage_v, 1.5 /", "make it a whole number of samples"),
    ("voltage_v, 1.0 /", "voltage_v * np.nan, 1.0 /", "no waveform of finite voltages"),
    ("import numpy as np", "import numpyy as np", "'swept_sine' cannot be loaded"),
])
def test_experiment_that_no_stage_can_play_is_refused_in_one_sentence(outside, old, new, message):
    rewrite(outside, old, new)
    with pytest.raises(ValueError, match=message) as refusal:
        named_experiment("swept_sine")
    assert "\n" not in str(refusal.value)


def test_identification_plays_and_records_the_experiment_from_outside(outside, nodes, tmp_path):
    client = nodes.start("recorder", "identification")
    with pytest.raises(GoalFailed, match="choose one of .*, swept_sine"):
        client.run_experiment("swept_sin", tmp_path)
    with Stage() as stage:
        ran = client.beside(stage.run_experiment, "swept_sine", tmp_path)
    assert ran.summary.startswith("sine from 5 Hz to 1 kHz around mid-range")
    recording = read_recording(ran.path)
    assert recording.gaps == []
    played = recording.select(recording.playing)
    designed_v = named_experiment("swept_sine").voltage_v
    np.testing.assert_allclose(played.voltage_v[:designed_v.size], designed_v, atol=1e-9)
    assert json.loads(recording.attachments["parameters.json"])["experiment"] == "swept_sine"
