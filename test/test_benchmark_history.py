# SPDX-License-Identifier: BSD-3-Clause
"""Results of each version are kept, and the page shows the last five."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def history(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import history

    yield history
    sys.modules.pop("history")


def row(name, median, verdict="at least 2: met"):
    return SimpleNamespace(name=name, unit="1/s", median=median, verdict=verdict)


def test_page_shows_the_last_five_versions_by_number(history, tmp_path):
    history.keep([row("loop", 3.0), row("peer", None)], tmp_path)
    now, = tmp_path.glob("*.json")
    content = json.loads(now.read_text())
    for version in ("0.0.2", "0.0.9", "0.0.10", "0.0.11", "0.0.12", "0.0.13"):
        older = content | {"version": version, "rows": [
            {"name": "loop", "unit": "1/s", "median": 12345.6, "verdict": ""}]}
        (tmp_path / f"{version}.json").write_text(json.dumps(older))
    page = history.page_of(tmp_path)
    head = next(line for line in page.splitlines() if line.startswith("| | "))
    versions = [cell.split(",")[0].strip() for cell in head.split("|")[2:-2]]
    assert versions == [content["version"], "0.0.13", "0.0.12", "0.0.11", "0.0.10"]
    assert "| loop (1/s) | 3 | 12,346 | 12,346 | 12,346 | 12,346 | at least 2: met |" in page
    assert "| peer (1/s) |  |  |  |  |  |" in page


def test_same_version_is_kept_once(history, tmp_path):
    history.keep([row("loop", 3.0)], tmp_path)
    history.keep([row("loop", 4.0)], tmp_path)
    assert len(list(tmp_path.iterdir())) == 1
    assert "| loop (1/s) | 4 |" in history.page_of(tmp_path)


def test_committed_page_is_that_of_the_history(history):
    assert history.PAGE.read_text(encoding="utf-8") == history.page_of()
