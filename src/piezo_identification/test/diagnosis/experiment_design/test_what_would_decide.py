# SPDX-License-Identifier: BSD-3-Clause
"""The next experiment in the verdict: only where rivals remain, and as `propose` designs it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from replaced import replaced
from short_identification import FEW_WAVEFORMS

from piezo_identification.commands.diagnose_command import main
from piezo_identification.diagnosis.experiment_design import propose as module
from piezo_identification.diagnosis.report import diagnosis_results
from piezo_identification.experiments.catalogue import Experiment
from piezo_models.effects.delay import Delay
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model

SCAN = Experiment("scan", 50.0 - 25.0 * np.cos(2e-3 * np.pi * np.arange(3000)), 1e-4, 1, "")


@pytest.mark.parametrize(("shares", "not_told_from", "expected"), [
    ({"delay": 0.7, "sensor_lag": 0.28, "something_else": 0.02}, {}, True),
    ({"delay": 0.97, "sensor_lag": 0.02, "something_else": 0.01}, {}, False),
    ({"delay": 0.93, "something_else": 0.07}, {}, False),
    ({"delay": 0.3, "sensor_lag": 0.1, "something_else": 0.6}, {}, False),
    ({"delay": 0.99}, {"sensor_lag": "delay"}, True),
    ({}, {}, False),
])
def test_several_remain_where_no_explanation_of_the_list_is_sure(shares, not_told_from, expected):
    verdict = {"effects": [{"name": "delay"}], "probabilities": shares,
               "not_told_from": not_told_from}
    assert module.several_remain(verdict) == expected


@pytest.fixture
def few_waveforms():
    with replaced(*FEW_WAVEFORMS):
        yield module.grid()


@pytest.fixture
def arguments(plant, play, csv_of, tmp_path):
    save_model(tmp_path / "model.json", IdentifiedModel(plant, (-20.0, 120.0)))
    scanned = play(SCAN, 1, 10_000.0, stage=replace(plant, effects=(Delay(1e-4),)))
    csv_of(scanned, tmp_path / "scan.csv")
    return ["--model", str(tmp_path / "model.json"), "--data", str(tmp_path / "scan.csv"),
            "--output", str(tmp_path / "out")]


@pytest.mark.long
def test_the_verdict_names_the_recording_that_tells_a_delay_from_a_lag(
        arguments, few_waveforms, tmp_path, capsys):
    assert main(arguments) == 0
    designed = json.loads((tmp_path / "out" / "verdict.json").read_text())["next_experiment"]
    assert designed["kind"] in {point.family.name for point in few_waveforms}
    rivals = {each["effects"]: each for each in designed["alternatives"]}
    assert {"delay", "sensor_lag"} <= set(rivals)
    assert all(apart_um > 0.0 for each in rivals.values()
               for apart_um in each["expected_rms_difference_um"].values())
    assert 0.0 <= designed["probability_of_deciding"] <= 1.0
    table = np.genfromtxt(tmp_path / "out" / designed["file"], delimiter=",", names=True)
    # The clock is that of the recording, and the voltages are those of the model.
    assert table["time_s"][1] == pytest.approx(1e-4)
    assert table["voltage_v"].min() == pytest.approx(designed["lowest_v"]) and (
        table["voltage_v"].max() == pytest.approx(designed["highest_v"]))
    assert -20.0 <= designed["lowest_v"] < designed["highest_v"] <= 120.0
    assert "what would decide:" in capsys.readouterr().out
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<h2>What would decide" in page and "Play next_experiment.csv" in page


@pytest.mark.usefixtures("without_pictures")
def test_ctrl_c_keeps_the_verdict_and_sets_aside_what_an_earlier_one_proposed(
        arguments, tmp_path, monkeypatch, few_effects):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(diagnosis_results, "what_would_decide", interrupted)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "next_experiment.csv").write_text("of an earlier verdict")
    with few_effects("amplifier_lag"):
        assert main(arguments) == 130
    verdict = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert verdict["interrupted"] and verdict["next_experiment"] is None
    # So slow a scan does not tell it from a lag, of the amplifier or of the sensor.
    (named,) = (entry["name"] for entry in verdict["effects"])
    assert {"delay", "sensor_lag"} <= {named, *verdict["not_decidable"]}
    assert not (tmp_path / "out" / "next_experiment.csv").exists()
    assert (tmp_path / "out" / "next_experiment.previous.csv").read_text() == (
        "of an earlier verdict")
