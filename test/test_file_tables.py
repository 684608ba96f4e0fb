# SPDX-License-Identifier: BSD-3-Clause
"""The page of the files tells the fields that the schemas check."""

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def tool():
    return runpy.run_path(str(ROOT / "tools" / "file_tables.py"))


def test_tables_are_up_to_date(tool):
    text = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    assert tool["page"](text) == text, "run make tables"


def test_table_tells_type_unit_range_and_meaning(tool):
    assert ("| `lead_ticks` | whole number |  | >= 1, <= 1e+09 | How many ticks ahead the output "
            "is written. |\n") in tool["table_of"]("calibration")
    assert ("| `hysteresis.density_um_per_v2` | list of lists of numbers | um/V^2 | >= 0, 1 or "
            "more entries |") in tool["table_of"]("model")
