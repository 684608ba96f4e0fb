# SPDX-License-Identifier: BSD-3-Clause
"""The plant shares no code with what is identified from it, and its numerics need no ROS."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import piezo_sim

MODULES = sorted(Path(piezo_sim.__file__).parent.glob("**/*.py"))
FOREIGN = {"piezo_models", "piezo_identification", "piezo_controller"}


def imported_packages(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield (node.module or "").partition(".")[0]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_no_module_imports_the_model_or_its_users(path):
    assert FOREIGN.isdisjoint(imported_packages(path))


def test_the_simulated_stage_loads_neither_model_nor_ros():
    program = (
        "import sys, piezo_sim.simulated_stage; "
        "print(*{name.split('.')[0] for name in sys.modules})")
    loaded = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert "piezo_sim" in loaded
    assert (FOREIGN | {"rclpy"}).isdisjoint(loaded)
