# SPDX-License-Identifier: BSD-3-Clause
"""No path leads from identification and control to the effects that the simulated stage hides."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src"
BLIND = ["piezo_models", "piezo_identification", "piezo_controller", "piezo_recorder"]


@pytest.mark.parametrize("package", BLIND)
def test_no_file_of_the_package_names_the_simulator(package):
    files = [
        path
        for folder in (package, "test", "config")
        for path in (SOURCE / package / folder).rglob("*")
        if path.suffix in {".py", ".yaml", ".json"}
    ]
    assert files
    naming = [path for path in files if "piezo_sim" in path.read_text(encoding="utf-8")]
    assert naming == []


def test_all_numerics_load_without_the_simulator():
    modules = [
        f"{package}.{path.stem}"
        for package in BLIND
        for path in sorted((SOURCE / package / package).glob("*.py"))
        if path.stem != "__init__" and not path.stem.endswith("_node")
    ]
    # A simulator that cannot be imported at all: whoever tries fails.
    program = (
        "import importlib, sys\n"
        "sys.modules['piezo_sim'] = None\n"
        "for name in sys.argv[1:]:\n"
        "    importlib.import_module(name)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program, *modules],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
