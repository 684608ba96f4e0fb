# SPDX-License-Identifier: BSD-3-Clause
import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOMS = ("piezo_models", "piezo_models.linear", "piezo_models.hysteresis")


@pytest.mark.parametrize("room", ROOMS)
def test_every_exported_name_is_there_and_the_lists_agree(room):
    package = importlib.import_module(room)
    tree = ast.parse(Path(package.__file__).read_text())
    typed = {alias.name: node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)
             for alias in node.names if node.module.startswith("piezo_models")}
    assert set(package.__all__) == typed.keys() <= set(dir(package))
    for name, module in typed.items():
        assert getattr(package, name) is getattr(importlib.import_module(module), name)


def test_name_that_is_not_exported_is_refused_as_python_does():
    with pytest.raises(ImportError, match="cannot import name 'Preisach'"):
        from piezo_models import Preisach  # noqa: F401
    with pytest.raises(AttributeError, match="has no attribute 'Preisach'"):
        importlib.import_module("piezo_models").Preisach  # noqa: B018


def test_importing_the_package_loads_no_library():
    script = ("import sys, piezo_models; from piezo_models import e_y_percent; "
              "print(*{'numba', 'scipy', 'control', 'pydantic'} & sys.modules.keys())")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                          check=True)
    assert done.stdout.split() == []
