# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of other makes are those of the recipe, and trials count what they are to count."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from piezo_models.cascade import StageModel
from piezo_models.effects.delay import Delay
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.reader import read_recording
from piezo_studies.other_makes import __main__, recordings
from piezo_studies.other_makes.makes import MAKES
from piezo_studies.other_makes.trial import Interval, Outcome, intervals


@pytest.mark.parametrize("name", MAKES)
def test_the_waveforms_keep_the_range_and_reach_the_first_mode(name):
    make = MAKES[name](0)
    for experiment in recordings.experiments(make).values():
        assert experiment.voltage_v.min() >= make.limits.voltage_min_v
        assert experiment.voltage_v.max() <= make.limits.voltage_max_v
    tones = recordings.tones(make, 0.02)
    assert tones[-1][0] == pytest.approx(make.first_mode_hz)
    assert 2.0 * tones[-1][0] < make.limits.sample_rate_hz


def test_a_table_is_read_as_it_was_recorded_and_its_noise_is_known(tmp_path, monkeypatch):
    make = MAKES["plays_15um"](3)
    short = {"fast": recordings.experiments(make)["fast"]}
    monkeypatch.setattr(recordings, "experiments", lambda make: short)
    recordings.record(make, tmp_path, 3)
    known = json.loads((tmp_path / recordings.KNOWN).read_text())
    assert known["true"] == make.true
    first = read_recording(tmp_path / "fast.csv")
    assert first.sample_rate_hz == pytest.approx(make.limits.sample_rate_hz)
    clean, _ = recordings.recorded(replace(make, noise_um=0.0), short["fast"], 1, 0.0)
    noise_um = first.displacement_um - clean[:, 2]
    assert np.std(noise_um) == pytest.approx(make.noise_um, rel=0.03)
    begin_s, end_s = known["recordings"]["fast"]["counted_s"]
    counted = (first.time_s >= begin_s) & (first.time_s <= end_s)
    assert np.ptp(first.voltage_v[counted]) < 0.5 * make.limits.span_v
    assert known["recordings"]["fast"]["noise_percent"] == pytest.approx(
        100.0 * make.noise_um / np.std(first.displacement_um[counted]), rel=0.03)


def test_intervals_set_each_parameter_beside_what_is_true():
    line = PreisachModel(0.0, 1.0, np.zeros((1, 1)), 0.0, np.ones(1))
    dynamics = ElectricVibrationDynamics(2e-5, np.array([700.0, 1010.0]), np.array([0.02, 0.03]))
    identified = IdentifiedModel(
        StageModel(line, CreepDynamics(), dynamics, effects=(Delay(3e-6),)), (0.0, 1.0),
        uncertainties={
            "dynamics": {"time_constant_s": 5e-6, "mode_frequencies_rad_per_s": [1.0, 7.0],
                         "damping_ratios": [1e-3, 1e-3]},
            "effects": [{"delay_s": 1e-6}]})
    found = {each.name: each for each in intervals(identified, {
        "mode_frequencies_rad_per_s": [1000.0], "damping_ratios": [0.02], "front_lag_s": [5e-5],
        "behind_lag_s": [0.0], "delay_s": [2e-6]})}
    assert found["mode_frequencies_rad_per_s[0]"].holds
    assert not found["damping_ratios[0]"].holds
    assert found["front_lag_s"] == Interval("front_lag_s", 5e-5, None, None)
    assert not found["front_lag_s"].holds
    assert not found["behind_lag_s"].holds
    assert found["delay_s"].holds


def test_a_mode_that_is_an_effect_of_the_model_counts_as_one_in_series():
    line = PreisachModel(0.0, 1.0, np.zeros((1, 1)), 0.0, np.ones(1))
    modes = (VibrationMode(1001.0, 0.02, 0.9), VibrationMode(2000.0, 0.05, 0.1))
    identified = IdentifiedModel(
        StageModel(line, CreepDynamics(), ElectricVibrationDynamics(), effects=modes),
        (0.0, 1.0), uncertainties={"effects": [
            {"frequency_rad_per_s": 1.0, "damping_ratio": 1e-3, "participation": 0.1},
            {"frequency_rad_per_s": 1.0, "damping_ratio": 1e-3, "participation": 0.1}]})
    found = intervals(identified, {"mode_frequencies_rad_per_s": [1000.0, 2000.0],
                                   "damping_ratios": [0.02, 0.03]})
    assert [each.value for each in found] == [1001.0, 0.02, 2000.0, 0.05]
    assert [each.holds for each in found] == [True, True, True, False]


def test_a_lag_that_is_truly_zero_counts_only_where_the_model_has_one():
    line = PreisachModel(0.0, 1.0, np.zeros((1, 1)), 0.0, np.ones(1))
    identified = IdentifiedModel(StageModel(line, CreepDynamics(), ElectricVibrationDynamics(
        0.0, np.array([1000.0]), np.array([0.02]))), (0.0, 1.0))
    true = {"mode_frequencies_rad_per_s": [1000.0], "damping_ratios": [0.02]}
    assert len(intervals(identified, true | {"behind_lag_s": [0.0]})) == 2
    assert len(intervals(identified, true | {"behind_lag_s": [1e-4]})) == 3


@pytest.mark.parametrize(("program", "said", "stages"), [
    ("while True: pass", "ended after", ["tube_11um"]),
    ("print('broken'); raise SystemExit(1)", "broken", ["plays_15um", "tube_11um"]),
    ("import os; print('0 %'); os.kill(os.getpid(), 9)", "killed by SIGKILL",
     ["plays_15um", "tube_11um"])])
def test_a_stage_that_ends_badly_does_not_end_the_study(program, said, stages, tmp_path,
                                                        monkeypatch, capsys):
    script = tmp_path / "python"
    script.write_text(f'#!/bin/sh\nulimit -S -t 1\nexec "{sys.executable}" -c "{program}"\n')
    script.chmod(0o755)
    monkeypatch.setattr(__main__.sys, "executable", str(script))
    __main__.main(["--stage", *stages, "--output", str(tmp_path)])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + len(stages)
    assert all(said in line for line in lines[2:])
    assert set(json.loads((tmp_path / __main__.TABLE).read_text())) == set(stages)


def test_a_row_says_which_errors_are_not_near_the_noise():
    outcome = Outcome(10.0, 12.0, {"slow": 0.19, "fast": 0.5, "mixed": 0.5},
                      {"slow": 0.01, "fast": 0.01, "mixed": 0.2}, ["creep"],
                      [Interval("delay_s", 1.0, 1.5, 0.4), Interval("delay_s", 1.0, None, None)])
    assert "0.19 (0.01) | **0.5** (0.01) | 0.5 (0.2) | creep | 1 of 2" in __main__.row("a", outcome)
