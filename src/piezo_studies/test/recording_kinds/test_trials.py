# SPDX-License-Identifier: BSD-3-Clause
"""The kinds of recordings are recorded as they are described, and are all tried."""

import subprocess
import sys

import numpy as np
import pytest

from piezo_recorder.reading.reader import read_recording
from piezo_studies.recording_kinds import __main__
from piezo_studies.recording_kinds.laboratory_voltages import KINDS
from piezo_studies.recording_kinds.trials import (
    COMMAND,
    STAGES,
    Outcome,
    Trial,
    displacement_um,
    duhem_stage,
    play_stage,
    recordings,
    run,
    trials,
)


def test_every_kind_is_tried_with_each_variant_and_without_each_other_experiment():
    planned = list(trials())
    assert len({str(trial) for trial in planned}) >= 2 * 70
    for experiment, kinds in KINDS.items():
        for kind in kinds:
            mine = [trial for trial in planned if trial.kinds.get(experiment) == kind]
            assert {trial.variant for trial in mine if trial.varied == experiment} == {
                "drift", "gap", "two recordings"}
            assert {len(trial.kinds) for trial in mine} == {2, 3}
            assert {trial.stage for trial in mine} == set(STAGES)


@pytest.mark.parametrize("stage", [play_stage(), duhem_stage()])
def test_loops_of_the_stages_lag_and_close(stage):
    phase = np.linspace(0.0, 4.0 * np.pi, 2001)
    driven_um = stage.hysteresis(50.0 - 50.0 * np.cos(phase))
    assert driven_um[1000] == pytest.approx(driven_um[2000], abs=0.01 * np.ptp(driven_um))
    assert driven_um[1750] - driven_um[1250] > 0.02 * np.ptp(driven_um)


@pytest.mark.parametrize("stage", [play_stage(), duhem_stage()])
def test_a_stage_creeps_within_its_rows(stage):
    """Points far between are those of a fast logger at the same instants."""
    voltage_v = np.repeat([0.0, 40.0, 90.0, 20.0, 0.0], 3)
    points_um = displacement_um(stage, voltage_v, 1.0)
    rows = 2000
    fine_um = displacement_um(stage, np.repeat(voltage_v, rows), 1.0 / rows)[::rows]
    assert points_um == pytest.approx(fine_um, abs=2e-4 * np.ptp(fine_um))


def test_a_gap_and_a_second_recording_are_written(tmp_path):
    [gap] = recordings("plays", "creep", "steps", "gap", tmp_path)
    assert len(read_recording(gap).gaps) == 1
    first, second = recordings("plays", "creep", "steps", "two recordings", tmp_path)
    np.testing.assert_allclose(
        read_recording(first).voltage_v, 100.0 - read_recording(second).voltage_v)


def test_a_table_that_was_ended_goes_on_where_it_stopped(tmp_path, monkeypatch, capsys):
    ran = []

    def pretended(trial, folder):
        ran.append(str(trial))
        return Outcome(float("nan") if len(ran) == 1 else 0.25, "adequate", 40.0)

    monkeypatch.setattr(__main__, "run", pretended)
    of_creep = ["--output", str(tmp_path), "--stage", "plays", "--only", "creep: trapezoids"]
    __main__.main([*of_creep, "--cpu-minutes", "1"])
    first = capsys.readouterr().out
    assert len(ran) == 2
    __main__.main(of_creep)
    whole = capsys.readouterr().out
    assert whole.startswith(first)
    assert len(set(ran)) == len(ran) == len(whole.splitlines()) - 2 > 4


def test_the_study_starts_a_command_that_there_is():
    started = subprocess.run([sys.executable, "-m", *COMMAND, "--help"], capture_output=True,
                             text=True, check=True)
    assert "--hysteresis" in started.stdout


@pytest.mark.long
@pytest.mark.parametrize("trial", [
    Trial("plays", {"creep": "trapezoids", "dynamics": "noise", "hysteresis": "nested triangles"}),
    Trial("Duhem", {"creep": "staircase", "dynamics": "steps", "hysteresis": "static points"})],
    ids=str)
def test_a_model_is_identified_or_called_inadequate(trial, tmp_path):
    outcome = run(trial, tmp_path)
    assert outcome.verdict.startswith("inadequate") or outcome.error_percent < 1.0, outcome
    assert not outcome.verdict.startswith("failed")
