# SPDX-License-Identifier: BSD-3-Clause
"""Many recordings from a table: resumed by content, with bad ones named and skipped."""

import json
import os
import re
import signal
import threading
from pathlib import Path

import numpy as np
import pytest

from piezo_identification.commands.diagnose_many_command import main
from piezo_identification.diagnosis.many import diagnose_table, many_recordings
from piezo_identification.diagnosis.many.diagnose_table import histories, many_page
from piezo_identification.diagnosis.many.many_recordings import diagnose_rows, read_table
from piezo_identification.diagnosis.report import diagnosis_results
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_file import save_model

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

    monkeypatch.setattr(diagnosis_results, "diagnose_files", diagnose)
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
    printed = capsys.readouterr()
    assert "first: explained delay\n" in printed.out
    assert "broken was skipped:" in printed.err and "bad.csv has gaps: record again" in printed.err
    page = (tmp_path / "out" / "index.html").read_text()
    assert "2 of 3 diagnosed: 2 explained" in page
    assert "bad.csv has gaps" in page
    assert re.search("002_b.*explained.*delay.*0.970.*80.*11.*10", page, re.DOTALL)
    assert (tmp_path / "out" / "summary.csv").read_text().count("explained") == 2
    assert printed.out.splitlines()[-1].startswith(
        f"next: ./run piezo_identification propose --model {tmp_path / 'model.json'} --verdict")

    diagnosed.clear()
    assert main(arguments) == 0
    assert diagnosed == ["broken"]
    assert "first: explained delay (done before)" in capsys.readouterr().out
    # Of a changed file the rows with it are done again, whatever its time of change.
    (tmp_path / "b.csv").write_text("time_s,voltage_v,displacement_um\nother\n")
    diagnosed.clear()
    assert main(arguments) == 0
    assert sorted(diagnosed) == ["002_b", "broken"]


def test_stages_of_a_fleet_stand_beside_each_other(tmp_path):
    rows, told = [], []
    for stage, recorded, verdict, rms_um in (
            ("old", "2026-03-01", "none", 0.01), ("old", "2026-05-01", "explained", 0.05),
            ("old", "2026-04-01", "unexplained", 0.03), ("new", "2026-03-02", "explained", 0.02),
            ("new", "2026-05-02T10:11:12", "none", 0.01), ("", "", "explained", 0.9)):
        lines = f"model,data,stage,recorded\nm,a,{stage},{recorded}\n"
        (tmp_path / "table.csv").write_text(lines)
        rows += read_table(tmp_path / "table.csv", tmp_path / "out")
        told.append({"name": stage, "is_new": True, "verdict": {
            **VERDICT, "verdict": verdict, "before": {"rms_um": rms_um}}})
    old, new = histories(rows, told)
    assert (old.stage, old.since.date().isoformat()) == ("old", "2026-04-01")
    assert old.row() == ["old", "3", "2026-03-01", "2026-05-01", "explained", "delay",
                         "2026-04-01", "10", "50"]
    assert (new.stage, new.since) == ("new", None)
    page = many_page(rows, told, [])
    assert page.index("<h2>Stages</h2>") < page.index("<h2>Recordings</h2>")
    assert "1 of 2 stages show an effect" in page
    assert "<h2>Stages</h2>" not in many_page(rows[-1:], told[-1:], [])


@pytest.mark.parametrize(("text", "sentence"), [
    ("model\nm\n", "lacks data"),
    ("model,data,colour\nm,a,red\n", "has colour"),
    ("model,data\nmodel.json,\n", "row 1 of .* has no data: name the file"),
    ("model,data\nm;n,a\n", "several files as model"),
    ("model,data,name\nm,a,x\nm,b,x\n", "row 2 of .* as one before it"),
    ("model,data,name\nm,a,../x\n", "give the name of a folder"),
    ("model,data\n", "has no rows"),
    ("model,data,recorded\nm,a,in May\n", "row 1 of .* was recorded 'in May': give a day"),
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


def sentences(results):
    return "\n".join(many_recordings.errors_of(results))


def test_rows_that_no_worker_can_do_are_named_with_what_to_do(table, tmp_path, monkeypatch):
    from distributed import Client

    monkeypatch.setattr(many_recordings, "LONELY_S", 0.0)
    monkeypatch.setattr(many_recordings, "ASKED_S", 0.01)
    rows = read_table(table, tmp_path / "out")
    with Client(processes=False, n_workers=0, dashboard_address=None) as client:
        told = diagnose_rows(client, rows, lambda done: None)
    assert len(told) == 3
    assert sentences(told).count("no worker for 0 s; start one with `dask worker ADDRESS`") == 3


def test_a_scheduler_that_goes_away_leaves_what_is_done(table, tmp_path, monkeypatch):
    from distributed import Client, LocalCluster

    gone = threading.Event()

    def diagnose(model, data, holdout, directory, progress, identified_from):
        if "a.csv" not in str(data[0]):
            assert gone.wait(60.0)
        Path(directory).mkdir(parents=True, exist_ok=True)
        (Path(directory) / "verdict.json").write_text(json.dumps(VERDICT))

    monkeypatch.setattr(diagnosis_results, "diagnose_files", diagnose)
    rows = read_table(table, tmp_path / "out")
    with LocalCluster(processes=False, n_workers=1, threads_per_worker=1,
                      dashboard_address=None) as cluster, Client(cluster) as client:
        def lose_the_scheduler(done):
            # What the client does where its connection breaks.
            for state in list(client.futures.values()):
                if state.status == "pending":
                    client.loop.add_callback(state.cancel, "scheduler-connection-lost", "gone")

        told = diagnose_rows(client, rows, lose_the_scheduler)
        gone.set()
    assert "verdict" in told[0]
    assert sentences(told).count("the scheduler is gone; start it, and begin again") == 2


class OfAWorkerThatDies:
    """A future, or a client of such: its result is lost and done again, or it is blamed."""

    def __init__(self, number, states):
        self._number, self._states = number, iter(states)

    @property
    def status(self):
        self._now = next(self._states, "finished")
        return self._now

    def result(self, timeout):
        return {"name": self._number}

    def exception(self):
        from distributed import KilledWorker

        return KilledWorker("row", None, 3)

    def release(self):
        """Do nothing."""


@pytest.mark.parametrize(("states", "alone", "expected"), [
    (["pending", "lost", "lost", "pending"], [], {"name": 0}),
    (["error"] * 9, [], {"name": 0}),
    (["error"] * 9, ["error"] * 9, "the workers that tried it died"),
], ids=["lost", "blamed", "killer"])
def test_rows_of_a_worker_that_dies_are_done_again(
        table, tmp_path, monkeypatch, states, alone, expected):
    monkeypatch.setattr(many_recordings, "_wait_for_one", lambda waiting: None)
    rows = read_table(table, tmp_path / "out")[:2]
    left = [OfAWorkerThatDies(0, states), OfAWorkerThatDies(1, states),
            OfAWorkerThatDies(0, alone), OfAWorkerThatDies(1, [])]

    class Client:
        def submit(self, work, row, pure):
            return left.pop(0)

        def nthreads(self):
            return {"a worker": 1}

        def cancel(self, futures):
            assert futures == []

    told = diagnose_rows(Client(), rows, lambda done: None)
    if isinstance(expected, dict):
        assert told == [expected, {"name": 1}]
    else:
        assert expected in told[0]["error"] and told[1] == {"name": 1}
        assert many_recordings.KILLED not in told[0]


@pytest.fixture
def five_recordings(tmp_path):
    """A line with noise, two of the recordings with a hum: made by NumPy alone."""
    line = StageModel(PreisachModel(0.0, 10.0, np.zeros((1, 1)), 0.0, np.array([2.0])),
                      CreepDynamics(), ElectricVibrationDynamics())
    save_model(tmp_path / "model.json", IdentifiedModel(line, (0.0, 10.0)))
    random, lines = np.random.default_rng(5), ["model,data,name"]
    time_s = 1e-3 * np.arange(3000)
    for number in range(5):
        voltage_v = np.repeat(random.uniform(0.0, 10.0, 150), 20)
        displacement_um = 2.0 * voltage_v + random.normal(scale=2e-3, size=time_s.size)
        if number > 2:
            displacement_um += 1.5 * np.sin(2.0 * np.pi * 37.3 * time_s)
        np.savetxt(tmp_path / f"{number}.csv", np.column_stack(
            [time_s, voltage_v, displacement_um]), delimiter=",", comments="",
            header="time_s,voltage_v,displacement_um")
        lines.append(f"model.json,{number}.csv,row{number}")
    (tmp_path / "table.csv").write_text("\n".join(lines) + "\n")
    return read_table(tmp_path / "table.csv", tmp_path / "out")


@pytest.mark.long
def test_a_worker_process_that_is_killed_loses_no_row(five_recordings):
    from distributed import Client, LocalCluster

    with LocalCluster(processes=True, n_workers=2, threads_per_worker=1,
                      dashboard_address=None) as cluster, Client(cluster) as client:
        killed = []

        def kill_first(done):
            if not killed:
                killed.append(cluster.workers[0].pid)
                os.kill(killed[0], signal.SIGKILL)

        told = diagnose_rows(client, five_recordings, kill_first)
        assert killed
        assert [result["verdict"]["verdict"] for result in told] == ["none"] * 3 + [
            "explained"] * 2
        assert [[effect["name"] for effect in result["verdict"]["effects"]]
                for result in told[3:]] == [["periodic_disturbance"]] * 2
        counted = []
        again = diagnose_rows(client, five_recordings, counted.append)
    assert counted == [1, 2, 3, 4, 5]
    assert not any(result["is_new"] for result in again)
    assert [result["verdict"] for result in again] == [result["verdict"] for result in told]
