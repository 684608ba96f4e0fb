# SPDX-License-Identifier: BSD-3-Clause
"""The list of the rooms is that of the sources, and no further rooms import each other."""

from pathlib import Path

import import_graph as graph
import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).parents[1]

ROOMS_IN_CIRCLES = 10
"""Of rooms that import each other within a package; none is to be added."""


@pytest.fixture(scope="module")
def imports():
    return graph.imports_between_rooms(ROOT / "src")


def test_list_of_the_picture_is_that_of_the_sources(imports, monkeypatch):
    monkeypatch.setattr(graph, "imports_between_rooms", lambda source: imports)
    assert graph.main(["--check"]) == 0, "run make tables"
    lines = graph.LIST.read_text(encoding="utf-8").splitlines()
    listed, room = set(), ""
    for line in lines[2:]:
        if line.startswith("    -> "):
            listed.add((room, line.removeprefix("    -> ")))
        elif line:
            room = line
    assert listed == set(imports)
    assert ("piezo_models/effects", "piezo_models/linear") in listed


def circles(edges):
    """Return the groups of rooms each of which reaches all others of its group."""
    rooms = np.unique([*edges])
    imported = np.array([[(above, below) in edges for below in rooms] for above in rooms])
    _, group = connected_components(imported, connection="strong")
    sizes = np.bincount(group)
    return [rooms[group == number].tolist() for number in np.flatnonzero(sizes > 1)]


def test_no_further_rooms_import_each_other(imports):
    in_circles = circles(imports)
    assert sum(map(len, in_circles)) <= ROOMS_IN_CIRCLES, in_circles


def test_rooms_of_the_identification_import_in_no_circle(imports):
    assert not [room for circle in circles(imports) for room in circle
                if room.startswith("piezo_identification/")]


def module(path, text=""):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def test_imports_are_found_wherever_they_stand_and_those_of_others_are_not(tmp_path):
    package = tmp_path / "piezo_a" / "piezo_a"
    module(package / "__init__.py")
    module(package / "low" / "one.py")
    module(package / "high" / "two.py", "from piezo_a.low.one import thing\nimport numpy\n"
                                        "def f():\n    import piezo_a.top\n")
    module(package / "top.py", "from piezo_a import low\nfrom piezo_interfaces.msg import X\n")
    assert graph.imports_between_rooms(tmp_path) == {
        ("piezo_a/high", "piezo_a"): 1, ("piezo_a/high", "piezo_a/low"): 1}


def test_circle_is_found():
    assert circles([("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")]) == [["a", "b", "c"]]
