# SPDX-License-Identifier: BSD-3-Clause
"""The command for measured data, on made-up files of the same layout."""

import json
from dataclasses import replace

import numpy as np
import pytest

from piezo_identification.estimators.frequency_response.response_fit import ResponseOrder
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_studies.measured_devices import measured, measured_work
from piezo_studies.measured_devices.measured import (
    CANTILEVER,
    MAJOR_LOOPS,
    NANOPOSITIONER,
    NESTED_LOOPS,
)
from piezo_studies.measured_devices.measured_command import main
from piezo_studies.measured_devices.measured_work import SETS

CANTILEVER_DYNAMICS = ElectricVibrationDynamics(
    1e-4, (6030.0, 10_800.0), (0.033, 0.035), (7850.0,), (0.05,)
)


def equally_wide_loops(size, scale):
    width = np.subtract.outer(np.arange(size), np.arange(size)) / size
    return np.tril(scale * (0.2 + np.exp(-5.0 * width)))


def write(path, header, *columns):
    path.parent.mkdir(exist_ok=True)
    np.savetxt(path, np.column_stack(columns), fmt="%.8g", delimiter=",", header=header,
               comments="")


def write_record(path, voltage_v, displacement_um, period_s, noise_um):
    noise = np.random.default_rng(5).normal(scale=noise_um, size=voltage_v.size)
    write(path, "time_s,voltage_v,displacement_um", period_s * np.arange(voltage_v.size),
          voltage_v, displacement_um + noise)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    directory = tmp_path_factory.mktemp("measured data")
    scanner = PreisachModel(0.0, 150.0, equally_wide_loops(100, 2e-3), -3.0)
    sample = np.arange(2400)
    major_v = np.abs((sample + 200) % 400 - 200) * 0.75
    nested_v = 75.0 - 45.0 * np.cos(sample / 400.0) - 30.0 * np.cos(sample / 20.0)
    nested_v[:40] = np.concatenate([np.linspace(0, 150, 20), np.linspace(150, 0, 20)])
    for name, voltage_v in ((MAJOR_LOOPS, major_v), (NESTED_LOOPS, nested_v)):
        write_record(directory / name, voltage_v, scanner.simulate(voltage_v), 1.2, 0.02)
    cantilever = StageModel(
        PreisachModel(-150.0, 150.0, equally_wide_loops(100, 1e-3), -20.0), CreepDynamics(),
        CANTILEVER_DYNAMICS,
    )
    time_s = 2e-4 * np.arange(45_000)
    sine_v = 150.0 * np.sin(2.0 * np.pi * (time_s - 1.1))
    voltage_v = np.where(time_s < 2.0, 0.0, sine_v)
    write_record(directory / CANTILEVER, voltage_v, cantilever.simulate(voltage_v, 2e-4), 2e-4,
                 0.02)
    # Nearly as close as on the real device, 3 %: several frequencies lie on every resonance.
    frequency_hz = np.geomspace(1.0, 1200.0, 160)
    modes = ElectricVibrationDynamics(2e-4, (2300.0, 5000.0), (0.03, 0.02), (2500.0,), (0.03,))
    creep = CreepDynamics((10.0, 160.0), (11.0, 175.0))
    gain = 0.6 * creep.response(frequency_hz) * modes.response(frequency_hz)
    gain *= np.exp(-2j * np.pi * frequency_hz * 1e-4)
    write(directory / NANOPOSITIONER, "frequency_hz,gain_re,gain_im", frequency_hz, gain.real,
          gain.imag)
    return directory


@pytest.fixture(scope="module")
def output(data, tmp_path_factory, picture_faults):
    directory = tmp_path_factory.mktemp("output")
    with pytest.MonkeyPatch.context() as patch:
        # Of the stage above, which has fewer modes than the real one.
        patch.setattr(measured, "ORDER", ResponseOrder(creep_pairs=2, modes=2, antiresonances=1))
        assert picture_faults(main, ["--data", str(data), "--output", str(directory / "new")]) == []
    return directory / "new"


@pytest.mark.long
def test_every_set_is_predicted_where_it_was_not_fitted(output):
    rows = json.loads((output / "table.json").read_text())["rows"]
    assert [row["data"] for row in rows] == [
        "scanner", "scanner", "cantilever", "nanopositioner", "nanopositioner"
    ]
    assert all(row["reached"] and row["fitted_on"] != row["tested_on"] for row in rows)
    errors = [row["ours"] for row in rows]
    # The noise makes 0.17 %, 0.17 % and 0.08 %; the response has none.
    for error, most in zip(errors, (0.19, 0.19, 0.09, 0.5, 0.1), strict=True):
        assert error < most


@pytest.mark.long
def test_poor_models_are_diagnosed_too(output):
    *scanners, cantilever, _ = json.loads((output / "table.json").read_text())["findings"]
    assert len(scanners) == 2
    assert cantilever["effects"][0] == "vibration_mode"
    # The static model lacks the electric lag, too, and no candidate is one.
    assert cantilever["after_percent"] < 0.6 * cantilever["before_percent"]
    # This scanner is symmetric.
    assert all(scanner["verdict"] == "none" for scanner in scanners)


@pytest.mark.long
def test_a_response_that_remains_far_above_its_noise_is_not_called_explained(output):
    nanopositioner = json.loads((output / "table.json").read_text())["findings"][-1]
    assert nanopositioner["verdict"] == "unexplained"
    assert set(nanopositioner["effects"]) <= {"creep"}
    assert nanopositioner["after_percent"] <= nanopositioner["before_percent"]


@pytest.mark.long
def test_there_is_a_picture_of_every_prediction(output):
    assert {path.name for path in output.glob("*.png")} == {
        "scanner_major_loops.png", "scanner_nested_loops.png", "cantilever_cycles.png",
        "nanopositioner.png",
    }


def test_missing_sets_are_skipped_with_a_line_that_says_how_to_get_them(
        data, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(measured_work, "SETS", [
        replace(each, measure=lambda data, output: ([
            measured.Figure("nanopositioner", "error", "all", "all", "%", np.nan, 1.0, 0.5)], []))
        for each in SETS])
    only = tmp_path / "data"
    (only / NANOPOSITIONER).parent.mkdir(parents=True)
    (only / NANOPOSITIONER).write_bytes((data / NANOPOSITIONER).read_bytes())
    assert main(["--data", str(only), "--output", str(tmp_path / "new")]) == 0
    skipped = [line for line in capsys.readouterr().out.splitlines() if line.startswith("skipped")]
    assert len(skipped) == len(SETS) - 1
    assert all(word in line for line in skipped for word in ("Source: ", "licence: ", "to fetch: "))
    rows = json.loads((tmp_path / "new" / "table.json").read_text())["rows"]
    assert {row["data"] for row in rows} == {"nanopositioner"}


def test_a_directory_without_any_set_is_refused(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert main(["--data", str(tmp_path / "empty"), "--output", str(tmp_path)]) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert "holds none of the measured sets" in printed.err
    assert NESTED_LOOPS in printed.out
