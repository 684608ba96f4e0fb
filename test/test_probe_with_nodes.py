# SPDX-License-Identifier: BSD-3-Clause
"""The identification node probes the simulated stage, and fits its experiments to what it found."""

import json
import re

import numpy as np
import pytest
from probes import write_short_probe

from piezo_client.client import GoalFailed
from piezo_client.stage import Stage
from piezo_identification.experiments.probing.probe_file import load_probe
from piezo_recorder.reading.reader import read_recording


def test_probe_of_another_stage_or_beside_recordings_is_refused(suite, tmp_path):
    write_short_probe(tmp_path)
    text = (tmp_path / "probe.json").read_text()
    (tmp_path / "probe.json").write_text(re.sub(
        '"voltage_max_v": [0-9.]+', '"voltage_max_v": 60.0', text, count=1))
    with pytest.raises(GoalFailed, match="made with voltage_max_v 60, the stage has 120"):
        suite.run_experiment("dynamics", tmp_path)
    with Stage("/left") as stage, pytest.raises(GoalFailed, match="leave one out"):
        suite.beside(stage.identify, tmp_path, [tmp_path] * 4, probe_first=True)


@pytest.mark.long
def test_probe_measures_the_stage_and_later_experiments_fit_it(nodes, tmp_path):
    client = nodes.start("recorder", "identification")
    with Stage() as stage:
        probed = client.beside(stage.run_experiment, "probe", tmp_path)
        document = load_probe(tmp_path / "probe.json")
        ran = client.beside(stage.run_experiment, "dynamics", tmp_path)
        # The plant file: 4909 rad/s damped by 0.082, noise of 0.009 um.
        rung = min(document.stage.modes, key=lambda mode: mode.damping_ratio)
        assert rung.frequency_hz == pytest.approx(4909.0 / (2.0 * np.pi), rel=0.01)
        assert rung.damping_ratio == pytest.approx(0.082, rel=0.1)
        assert document.stage.noise_rms_um == pytest.approx(0.009, rel=0.05)
        assert document.stage.gain_um_per_v > 0.0
        assert "um RMS" in probed.summary
        steps = sorted((tmp_path / "probe").iterdir())
        assert {step.name for step in steps} >= {"rest", "pulse", "ringing", "creeping"}
        for step in steps:
            recording = read_recording(step)
            assert recording.gaps == []
            assert np.abs(recording.voltage_v).max() <= document.stage.step_v + 1e-9
            assert recording.voltage_v[-1] == 0.0
        fitted = document.fitted("dynamics")
        told = json.loads(read_recording(ran.path).attachments["parameters.json"])
        assert told["duration_s"] == pytest.approx(fitted["duration_s"])
        played = read_recording(ran.path)
        played_v = played.select(played.playing).voltage_v
        assert np.ptp(played_v) == pytest.approx(fitted["swing_v"])


@pytest.mark.long
def test_identification_that_probes_first_reaches_the_error_of_the_default_one(
        nodes, identification, tmp_path):
    client = nodes.start("recorder", "identification", namespace="/probed")
    with Stage("/probed") as stage:
        probed = client.beside(stage.identify, tmp_path, probe_first=True)
    assert len(probed.recordings) == 4
    assert probed.errors["e_y_percent"] <= 1.2 * identification.errors["e_y_percent"]
