# SPDX-License-Identifier: BSD-3-Clause
"""The cases of the suite, their outcomes, and that the table does not depend on where it ran."""

import subprocess
import sys
import time
from collections import Counter

import pytest
from distributed import Client

from piezo_studies.diagnosis_benchmark import run_suite as command
from piezo_studies.diagnosis_benchmark.cases import draw_cases
from piezo_studies.diagnosis_benchmark.outcome import as_text, outcome, refused, summary
from piezo_studies.diagnosis_benchmark.suite_command import main
from piezo_studies.kept_results import KeptResults

COUNT, SEED = 2, 190


def result(causes=(), effects=(), verdict="explained", not_decidable=(), later=True, lacking=9.0,
           in_model=()):
    return {
        "model": "identified before" if later else "identified with the effects",
        "contributions": [
            {"cause": cause, "over_noise": size, "beyond_model_over_noise": beyond}
            for cause, size, beyond in causes
        ],
        "effects": list(effects), "verdict": verdict, "not_decidable": list(not_decidable),
        "lacking_over_noise": lacking, "after_um": 1.1, "perfect_um": 1.0,
        "in_model": list(in_model), "probabilities": {},
    }


def test_the_suite_has_the_cases_it_must_have_and_the_same_for_the_same_seed():
    cases = draw_cases(260, 1)
    kinds = Counter(
        "clean" if not case.causes else "outside" if case.outside else len(case.causes)
        for case in cases
    )
    assert kinds == {"clean": 40, "outside": 20, 1: 148, 2: 52}
    assert len({(case.kind, case.slow) for case in cases}) == 8
    assert cases == draw_cases(260, 1) != draw_cases(260, 2)


@pytest.mark.parametrize(("case", "expected"), [
    (result(verdict="none"), ("clean", "right")),
    (result(verdict="unexplained"), ("clean", "false alarm")),
    (result([("self_heating", 9.0, 2.0)], verdict="unexplained"), ("outside", "right")),
    (result([("self_heating", 9.0, 2.0)], ["creep"]), ("outside", "explained")),
    (result([("delay", 9.0, 2.0)], ["delay"]), ("clear", "right")),
    (result([("delay", 9.0, 2.0)], ["delay"], later=False), ("weak", "right")),
    (result([("delay", 9.0, 5.0)], ["delay"], later=False), ("clear", "right")),
    (result([("delay", 9.0, 5.0)], later=False, lacking=1.0), ("weak", "no name")),
    (result([("delay", 9.0, 5.0)], verdict="none", later=False, in_model=["delay"]),
     ("clear", "right")),
    (result([("delay", 9.0, 5.0)], verdict="none", later=False, in_model=["sensor_lag"]),
     ("clear", "no name")),
    (result([("delay", 9.0, 2.0)], ["creep"]), ("clear", "wrong")),
    (result([("delay", 9.0, 2.0)], ["delay", "creep"]), ("clear", "wrong beside")),
    (result([("delay", 9.0, 2.0)], ["sensor_lag"], not_decidable=["delay"]),
     ("clear", "not decidable")),
    (result([("delay", 9.0, 2.0)], verdict="none"), ("clear", "no name")),
    (result([("delay", 9.0, 2.0), ("creep", 5.0, 2.0)], ["creep", "delay"]), ("clear", "right")),
    (result([("delay", 9.0, 2.0), ("creep", 4.0, 2.0)], ["creep", "delay"]), ("clear", "wrong")),
])
def test_outcome_of_a_case(case, expected):
    assert outcome(case) == expected


def test_a_refused_case_counts_as_missed():
    case = next(case for case in draw_cases(260, 1) if len(case.causes) == 1 and not case.outside)
    missed = refused(case, ValueError("record longer"))
    assert missed["error"] == "record longer" and outcome(missed) == ("clear", "refused")
    document = summary([missed, result([("delay", 9.0, 2.0)], ["delay"])])
    assert document["figures"]["named_first_percent"] == 50.0
    assert document["confusion"][case.causes[0]]["refused"] == 1


def test_the_summary_counts_what_is_not_decidable_apart():
    document = summary([
        result([("delay", 9.0, 2.0)], ["delay"]),
        result([("delay", 9.0, 2.0)], ["sensor_lag"], not_decidable=["delay"]),
        result([("delay", 2.0, 2.0)], ["creep"]),
    ])
    assert document["figures"]["named_first_percent"] == 100.0
    assert document["figures"]["named_first_of_all_percent"] == 50.0
    assert document["confusion"] == {"delay": {"delay": 1, "sensor_lag": 1}}
    assert document["figures"]["error_within_1.2_percent"] == 100.0
    assert "delay 1, sensor_lag 1" in as_text(document)


@pytest.fixture
def scheduler(tmp_path):
    """Address of a scheduler with two workers, each a process of its own."""
    file = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    options = ["--scheduler-file", str(file), "--no-dashboard"]
    processes = [subprocess.Popen(
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", *options],
        stderr=subprocess.DEVNULL,
    )]
    processes += [subprocess.Popen(
        [*dask, "worker", "--nthreads", "1", "--local-directory", str(tmp_path), *options],
        stderr=subprocess.DEVNULL,
    ) for _ in range(2)]
    try:
        while not file.exists() or not file.stat().st_size:
            assert processes[0].poll() is None
            time.sleep(0.05)
        with Client(scheduler_file=str(file)) as client:
            client.wait_for_workers(2, timeout=60)
            yield client.scheduler.address
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            process.wait(timeout=20)


@pytest.mark.long
def test_the_table_is_the_same_in_this_process_and_on_a_cluster(scheduler):
    with Client(processes=False, n_workers=1, threads_per_worker=1,
                dashboard_address=None) as client:
        here = command.run_suite(client, COUNT, SEED)
    with Client(scheduler) as client:
        there = command.run_suite(client, COUNT, SEED)
    assert there == here
    assert [entry["number"] for entry in here["results"]] == list(range(COUNT))


def test_a_case_that_is_refused_does_not_end_the_suite(monkeypatch):
    def refuse(case, model, experiments):
        raise ValueError(f"case {case.number} cannot be diagnosed")

    monkeypatch.setattr(command, "run_case", refuse)
    monkeypatch.setattr(command, "clean_model", lambda seed, plant: None)
    with Client(processes=False, n_workers=1, dashboard_address=None) as client:
        table = command.run_suite(client, COUNT, SEED)
    assert [entry["error"] for entry in table["results"]] == [
        f"case {number} cannot be diagnosed" for number in range(COUNT)]


def told(case, clean, experiments):
    """Stand in for `run_case`: name a delay, and a sensor's lag before any experiment."""
    last = result([("delay", 9.0, 2.0)], ["delay"])
    before = {"verdict": "explained", "effects": ["sensor_lag"], "not_decidable": ["delay"]}
    return {**last, "number": case.number, "experiments": experiments,
            "before_experiments": before if experiments else {}}


@pytest.fixture
def cluster(monkeypatch):
    monkeypatch.setattr(command, "run_case", told)
    monkeypatch.setattr(command, "clean_model", lambda seed, plant: None)
    with Client(processes=False, n_workers=1, dashboard_address=None) as client:
        yield client


def test_a_run_goes_on_from_what_is_kept_under_the_same_conditions(cluster, tmp_path):
    path, conditions = tmp_path / "cases.jsonl", {"seed": SEED}
    done = []
    command.run_suite(cluster, 5, SEED, done.append, first=2, kept=KeptResults(path, conditions))
    whole = command.run_suite(cluster, 5, SEED, done.append, kept=KeptResults(path, conditions))
    assert done == [1, 2, 3, 4, 5]
    assert [entry["number"] for entry in whole["results"]] == list(range(5))
    assert whole == command.run_suite(cluster, 5, SEED)
    assert KeptResults(path, {"seed": SEED + 1}).results() == {}


def test_cases_that_are_kept_beyond_those_asked_for_are_no_progress(cluster, tmp_path):
    kept, done = KeptResults(tmp_path / "cases.jsonl", {}), []
    kept.add(4, {"number": 4})
    table = command.run_suite(cluster, 5, SEED, done.append, first=2, kept=kept)
    assert done == [1, 2] and len(table["results"]) == 2


def test_outcomes_before_the_experiments_are_told_beside_those_after_them(cluster):
    table = command.run_suite(cluster, 3, SEED, experiments=1)
    assert table["outcomes"]["clear"] == {"right": 3}
    assert table["outcomes_before"]["clear"] == {"not decidable": 3}
    assert "before any experiment" in as_text(table)
    assert "before any experiment" not in as_text(command.run_suite(cluster, 3, SEED))


def test_a_scheduler_that_is_not_there_is_told_in_one_line(capsys, monkeypatch):
    monkeypatch.setattr("piezo_identification.diagnosis.many.many_recordings.CONNECT_S", 1)
    assert main(["--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "no scheduler at tcp://127.0.0.1:9" in capsys.readouterr().err
