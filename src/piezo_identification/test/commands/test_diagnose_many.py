# SPDX-License-Identifier: BSD-3-Clause
"""Many recordings from a table: resumed by content, with bad ones named and skipped."""

import json
import re
from pathlib import Path

import pytest

from piezo_identification.commands.diagnose_many_command import main
from piezo_identification.diagnosis.many import diagnose_table, many_recordings
from piezo_identification.diagnosis.many.many_recordings import read_table
from piezo_identification.diagnosis.report import results

VERDICT = {
    "verdict": "explained", "effects": [{"name": "delay"}], "before": {"rms_um": 0.08},
    "after": {"rms_um": 0.011}, "noise_floor_um": 0.01,
    "probabilities": {"delay": 0.97, "something_else": 0.03}}


@pytest.fixture
def diagnosed(monkeypatch):
    """Put the writing of a verdict in place of the work, and threads in place of processes."""
    from distributed import Client

    calls = []

    def diagnose(model, data, holdout, directory, progress, identified_from):
        calls.append(Path(directory).name)
        if "bad" in Path(data[0]).read_text():
            raise ValueError(f"{data[0]} has gaps: record again")
        Path(directory).mkdir(parents=True, exist_ok=True)
        (Path(directory) / "verdict.json").write_text(json.dumps(VERDICT))

    monkeypatch.setattr(results, "diagnose_files", diagnose)
    monkeypatch.setattr(diagnose_table, "cluster_client", lambda scheduler: Client(
        processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None))
    return calls


@pytest.fixture
def table(tmp_path):
    for name in ("a", "b", "bad"):
        (tmp_path / f"{name}.csv").write_text(f"time_s,voltage_v,displacement_um\n{name}\n")
    (tmp_path / "model.json").write_text("{}")
    path = tmp_path / "table.csv"
    path.write_text("model,data,name\nmodel.json,a.csv,first\nmodel.json,b.csv; a.csv,\n"
                    "model.json,bad.csv,broken\n")
    return path


def test_what_is_done_is_not_done_again_and_a_bad_recording_is_named(
        diagnosed, table, tmp_path, capsys):
    arguments = [str(table), "--output", str(tmp_path / "out")]
    assert main(arguments) == 0
    assert sorted(diagnosed) == ["002_b", "broken", "first"]
    told = capsys.readouterr()
    assert "first: explained delay\n" in told.out
    assert "broken was skipped:" in told.err and "bad.csv has gaps: record again" in told.err
    page = (tmp_path / "out" / "index.html").read_text()
    assert "2 of 3 diagnosed: 2 explained" in page
    assert "bad.csv has gaps" in page
    assert re.search("002_b.*explained.*delay.*0.970.*80.*11.*10", page, re.DOTALL)
    assert (tmp_path / "out" / "summary.csv").read_text().count("explained") == 2

    diagnosed.clear()
    assert main(arguments) == 0
    assert diagnosed == ["broken"]
    assert "first: explained delay (done before)" in capsys.readouterr().out
    # Of a changed file the rows with it are done again, whatever its time of change.
    (tmp_path / "b.csv").write_text("time_s,voltage_v,displacement_um\nother\n")
    diagnosed.clear()
    assert main(arguments) == 0
    assert sorted(diagnosed) == ["002_b", "broken"]


@pytest.mark.parametrize(("text", "sentence"), [
    ("model\nm\n", "lacks data"),
    ("model,data,colour\nm,a,red\n", "has colour"),
    ("model,data\nmodel.json,\n", "row 1 of .* has no data: name the file"),
    ("model,data\nm;n,a\n", "several files as model"),
    ("model,data,name\nm,a,x\nm,b,x\n", "row 2 of .* as one before it"),
    ("model,data,name\nm,a,../x\n", "give the name of a folder"),
    ("model,data\n", "has no rows"),
])
def test_a_table_that_cannot_be_used_is_refused(tmp_path, text, sentence):
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(ValueError, match=sentence):
        read_table(tmp_path / "table.csv", tmp_path / "out")


def test_a_scheduler_that_is_not_there_is_told_in_one_line(table, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(many_recordings, "CONNECT_S", 1)
    assert main([str(table), "--scheduler", "tcp://127.0.0.1:9",
                 "--output", str(tmp_path / "out")]) == 2
    assert "no scheduler at tcp://127.0.0.1:9" in capsys.readouterr().err
