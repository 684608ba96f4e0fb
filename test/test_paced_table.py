# SPDX-License-Identifier: BSD-3-Clause
"""The table of the paced loop on board adds its pieces, and takes those of like conditions only."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def paced_table(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import paced_table

    yield paced_table
    sys.modules.pop("paced_table")


def run_of(missed_deadlines, longest_ms):
    return SimpleNamespace(
        ticks=1000, lost_samples=0, missed_feedback=1, fed_back_ticks=998,
        missed_deadlines=missed_deadlines, counted_ticks=1100,
        described={"longest_wait_of_a_tick_ms": str(longest_ms), "real_time": "priority 40"},
        bare_timer={"wakes": 500, "late": 2, "latest_ms": 1.5},
        histogram={"within 0.2 ms": 1100 - missed_deadlines, "beyond 100 ms": missed_deadlines})


@pytest.fixture
def of_runs(paced_table, monkeypatch, tmp_path):
    """Return what runs the command over made-up runs, each in place of ten seconds."""
    left, page = [run_of(0, 0.3), run_of(11, 7.0), run_of(22, 2.0), run_of(33, 3.0)], \
        tmp_path / "page.md"
    page.write_text("before\n<!-- paced loop on board -->\nold\n<!-- end -->\nafter\n")

    def next_run(directory, seconds, busy):
        if not left:
            raise KeyboardInterrupt
        return left.pop(0)

    monkeypatch.setattr(paced_table, "onboard_run", next_run)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", [
            "paced_table", "--piece", "10", "--output", str(tmp_path), "--page", str(page),
            *arguments])
        paced_table.main()
        return page.read_text()

    run.left, run.pieces = left, tmp_path / "pieces.jsonl"
    return run


def test_pieces_are_added(of_runs):
    text = of_runs("20")
    assert text.startswith("before\n") and text.endswith("<!-- end -->\nafter\n")
    rows = {cells[1].strip(): [cell.strip() for cell in cells[2:-1]] for cells in (
        line.split("|") for line in text.splitlines()) if len(cells) > 3}
    assert rows["time"] == ["20 s", "20 s"]
    assert rows["ticks of the run"] == ["2000", "2000"]
    # One that the stage missed and two that were not told, in each of two pieces.
    assert rows["feedback values late or missing"] == ["6", "6"]
    assert rows["ticks that missed their deadline"] == ["11 of 2200, 0.5 %", "55 of 2200, 2.5 %"]
    assert rows["longest wait of a tick"] == ["7 ms", "3 ms"]
    assert rows["ticks begun within 0.2 ms"] == ["99.5 %", "97.5 %"]


def test_an_interrupted_run_goes_on_where_it_was(of_runs):
    saved = of_runs.left[3:]
    del of_runs.left[3:]
    with pytest.raises(KeyboardInterrupt):
        of_runs("20")
    assert len(of_runs.pieces.read_text().splitlines()) == 3
    of_runs.left.extend(saved)
    assert "55 of 2200" in of_runs("20")
    assert not of_runs.left
    # All pieces are there: none is run again.
    assert "55 of 2200" in of_runs("20")


def test_pieces_of_another_commit_do_not_count(of_runs):
    of_runs("10")
    pieces = [json.loads(line) for line in of_runs.pieces.read_text().splitlines()]
    of_runs.pieces.write_text("".join(
        json.dumps(piece | {"conditions": piece["conditions"] | {"commit": "of yesterday"}}) + "\n"
        for piece in pieces))
    assert "33 of 1100" in of_runs("10")
