# SPDX-License-Identifier: BSD-3-Clause
"""`piezo` runs the offline commands of all packages, with the same options."""

import re
import shlex
import warnings
from pathlib import Path

import numpy as np
import pytest

from piezo_models import (
    CreepDynamics,
    ElectricVibrationDynamics,
    IdentifiedModel,
    PreisachModel,
    StageModel,
    save_model,
)
from piezo_offline.piezo_command import COMMANDS, main


@pytest.mark.parametrize("name", COMMANDS)
def test_subcommand_takes_the_options_of_the_command(name, capsys):
    for run, arguments in ((main, [name, "--help"]), (COMMANDS[name].main, ["--help"])):
        with pytest.raises(SystemExit) as ended:
            run(arguments)
        assert ended.value.code == 0
    told = capsys.readouterr().out
    under_piezo, alone = told.split(f"usage: {name} ")
    assert under_piezo.startswith(f"usage: piezo {name} ")
    options = {word for word in alone.split() if word.startswith("--")}
    assert options <= set(under_piezo.split())


def test_bad_input_is_said_in_one_line_under_the_name_that_was_typed(tmp_path, capsys):
    missing = tmp_path / "none.csv"
    assert main(["check", "--data", str(missing)]) == 2
    assert capsys.readouterr().err == f"piezo check: {missing} does not exist: check the path\n"


def test_report_of_a_table_names_the_command_to_type_next(tmp_path, capsys):
    table = tmp_path / "mine.csv"
    table.write_text("time_s,voltage_v,displacement_um\n" + "".join(
        f"{k * 0.001:.3f},{k % 7},{k % 5}\n" for k in range(50)))
    assert main(["report", str(table)]) == 0
    told = capsys.readouterr().out.splitlines()
    assert "50 samples" in told[0]
    assert told[-1] == f"next: piezo check --data {table}"


def test_the_command_alone_explains_itself_and_says_its_version(capsys):
    assert main([]) == 2
    assert "check" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert re.fullmatch(r"piezo \d+\.\d+\.\d+\n", capsys.readouterr().out)


def test_a_following_command_describes_the_columns_alike(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time_s = 0.01 * np.arange(300)
    monitor_v = 2.5 - 2.5 * np.cos(3.0 * time_s)
    np.savetxt("mine.csv", np.column_stack([time_s, monitor_v, 8.0 * monitor_v]), delimiter=",",
               comments="", header="t [s],monitor [V],y [um]")
    columns = ["--columns", "voltage=monitor[20V]"]
    given = ["--hysteresis", "mine.csv", "--validation", "mine.csv", "--grid", "5", *columns]
    assert main(["identify", *given, "--output", "line.json", "--no-report"]) == 0
    simulate = ["simulate", "--model", "line.json", "--data", "mine.csv", *columns]
    assert f"next: piezo {shlex.join(simulate)} --output line\n" in capsys.readouterr().out
    assert main(simulate) == 0
    assert f" --data mine.csv {shlex.join(columns)} " in capsys.readouterr().out.splitlines()[-1]


def test_a_file_that_is_no_model_is_kept_before_anything_is_estimated(tmp_path, capsys):
    table = tmp_path / "mine.csv"
    table.write_text("time_s,voltage_v,displacement_um\n0,0,0\n")
    assert main(["identify", "--hysteresis", str(table), "--output", str(table)]) == 2
    told = capsys.readouterr()
    assert "is no model file, so it is not overwritten" in told.err and told.out == ""


@pytest.fixture
def given(tmp_path, monkeypatch):
    """Work in a folder with files that are easily mistaken for one another."""
    monkeypatch.chdir(tmp_path)
    line = PreisachModel.line(0.0, 10.0, 2.0)
    stage = StageModel(line, CreepDynamics(), ElectricVibrationDynamics())
    save_model("model.json", IdentifiedModel(stage, voltage_range_v=(0.0, 10.0)))
    rows = [f"{number},{number % 3},{number % 5}" for number in range(40)]
    for name, written in {"mine.csv": rows, "falling.csv": reversed(rows)}.items():
        Path(name).write_text("\n".join(["time_s,voltage_v,displacement_um", *written]) + "\n")
    Path("empty").mkdir()


@pytest.mark.parametrize(("typed", "said"), [
    ("check --data model.json", "model.json is a JSON document, such as a model file, and no "
     "table: give a recording, or a table of time, voltage and displacement"),
    ("identify --creep model.json --output new.json", "model.json is a JSON document"),
    ("diagnose --model model.json --data model.json --output out", "model.json is a JSON document"),
    ("simulate --model mine.csv --data mine.csv", "mine.csv: is not valid JSON"),
    ("check --data falling.csv",
     "falling.csv, row 3: the time falls from row to row: sort the rows by their time"),
    ("check --data empty", "it holds no other file; give a recording or a table"),
    ("check --data mine.csv --output mine.csv",
     "mine.csv is a file, not a folder: name a folder to write to"),
    ("diagnose --model model.json --data mine.csv --output mine.csv", "is a file, not a folder"),
    ("waveforms --directory mine.csv --range 0 1 --rate 1e4", "is a file, not a folder"),
    ("identify --creep mine.csv --output empty", "empty is a folder: name a file as --output"),
    ("identify --creep mine.csv --output no/new.json", "is no file in an existing directory"),
    ("identify --creep mine.csv --output new.json --grid 5000", "grid is 5000: give 4 to 300"),
    ("design --model model.json --output new.json --samples-per-tick 0",
     "--samples-per-tick is 0: give 1 or more"),
    ("identify --crep mine.csv --output new.json",
     "--crep mine.csv is no option of it: `piezo identify --help` lists them"),
])
def test_a_wrong_input_is_refused_in_one_sentence(given, typed, said, capsys):
    assert main(typed.split()) == 2
    line, = capsys.readouterr().err.splitlines()
    assert line.startswith(f"piezo {typed.split()[0]}: ") and said in line


def test_a_constant_recording_without_noise_is_drawn_without_a_word_on_stderr(given, capsys):
    Path("rest.csv").write_text("time_s,voltage_v,displacement_um\n" + "".join(
        f"{number},3,1\n" for number in range(40)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert main(["check", "--data", "rest.csv", "--no-report"]) == 0
    assert "the displacement is 1 um throughout" in capsys.readouterr().out
