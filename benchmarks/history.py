# SPDX-License-Identifier: BSD-3-Clause
"""Keep the results of each version, and set those of the last ones beside each other."""

import json
import os
import platform
import tomllib
from datetime import date
from pathlib import Path

ROOT = Path(__file__).parents[1]
HISTORY = Path(__file__).parent / "history"
PAGE = ROOT / "docs" / "benchmarks.md"
SHOWN = 5
"""Versions on the page, the newest first."""

HEAD = """\
# Benchmarks

Written by `make bench`; do not edit. Each column has the medians of one version, which
`benchmarks/history.py` keeps, and the last one what they are to reach. Compare columns of the same
machine only.

"""


def keep(rows, folder=HISTORY):
    """Keep the medians of this version in place of what was measured of it before."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    folder.mkdir(exist_ok=True)
    (folder / f"{project['version']}.json").write_text(json.dumps({
        "version": project["version"], "date": date.today().isoformat(),
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, "
                   f"Python {platform.python_version()}",
        "rows": [{"name": row.name, "unit": row.unit, "median": row.median,
                  "verdict": row.verdict} for row in rows]}, indent=1) + "\n", encoding="utf-8")


def page_of(folder=HISTORY):
    """Return the page of the last versions that were kept."""
    kept = [json.loads(path.read_text(encoding="utf-8")) for path in folder.glob("*.json")]
    kept.sort(key=lambda each: [int(part) for part in each["version"].split(".")], reverse=True)
    shown = kept[:SHOWN]
    if not shown:
        return HEAD + "No version is kept yet.\n"
    medians = [{(row["name"], row["unit"]): row["median"] for row in each["rows"]}
               for each in shown]
    lines = ["| | " + " | ".join(f"{each['version']}, {each['date']}" for each in shown)
             + " | to reach |", "|---" * (len(shown) + 2) + "|",
             "| machine | " + " | ".join(each["machine"] for each in shown) + " | |"]
    for row in shown[0]["rows"]:
        figures = " | ".join(_figure(each.get((row["name"], row["unit"]))) for each in medians)
        lines.append(f"| {row['name']} ({row['unit']}) | {figures} | {row['verdict']} |")
    return HEAD + "\n".join(lines) + "\n"


def _figure(value):
    return "" if value is None else f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}"
