# SPDX-License-Identifier: BSD-3-Clause
"""docs/errors.md tells every refusal and trip with what to do, from the sources."""

import ast
from pathlib import Path

import error_table
import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def page():
    return error_table.page()


def refused(code):
    return [error_table.refusal(node) for node in error_table.statements(ast.parse(code))
            if error_table.refusal(node)]


@pytest.mark.parametrize(("code", "text"), [
    ("raise ValueError(f'{path}: too short: record longer')", "<path>: too short: record longer"),
    ("raise GoalFailed(name, Result(message='nobody serves it: start its node'))",
     "nobody serves it: start its node"),
    ("self.refuse('format', 'is old', 'identify again')", "format is old; identify again"),
    ("response.message = 'Nothing runs: start it.'", "Nothing runs: start it."),
])
def test_refusal_is_found_with_its_text(code, text):
    assert refused(code) == [text]


def test_trips_of_the_guards_and_of_the_feedback_are_told(page):
    trips = page.split("## piezo_")[0]
    assert "the sensor is stuck" in trips
    assert trips.count("| `safety.guards` |") >= 4


def test_page_in_the_docs_has_the_shape_that_make_docs_gives_it(page):
    """Its rows may lag behind the sources until `make docs` is run; its sections may not."""
    written = (ROOT / "docs" / "errors.md").read_text()
    assert [line for line in written.splitlines() if line.startswith("#")] == [
        line for line in page.splitlines() if line.startswith("#")]
