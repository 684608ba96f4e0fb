# SPDX-License-Identifier: BSD-3-Clause
import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOMS = ("piezo_identification", "piezo_identification.prediction")


@pytest.mark.parametrize("room", ROOMS)
def test_every_exported_name_is_there_and_the_lists_agree(room):
    package = importlib.import_module(room)
    tree = ast.parse(Path(package.__file__).read_text())
    typed = {alias.name: node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)
             for alias in node.names if node.module.startswith("piezo_identification")}
    assert set(package.__all__) == typed.keys() <= set(dir(package))
    for name, module in typed.items():
        assert getattr(package, name) is getattr(importlib.import_module(module), name)


@pytest.mark.parametrize("room", ROOMS)
def test_exported_names_are_not_those_of_modules(room):
    # Importing the module first would put it in the place of the exported function.
    package = importlib.import_module(room)
    folder = Path(package.__file__).parent
    assert not {path.stem for path in folder.iterdir()} & set(package.__all__)


def test_names_that_users_need_come_from_the_package():
    from piezo_identification import diagnose, identify, predict

    assert all(map(callable, (diagnose, identify, predict)))


def test_importing_the_package_loads_no_library():
    script = ("import sys, piezo_identification, piezo_identification.prediction; "
              "print(*{'numba', 'scipy', 'control', 'numpy'} & sys.modules.keys())")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                          check=True)
    assert done.stdout.split() == []
