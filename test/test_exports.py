# SPDX-License-Identifier: BSD-3-Clause
"""The names that the packages export are there, and cost nothing until they are used."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGES = ("piezo_identification", "piezo_models", "piezo_offline", "piezo_recorder", "piezo_sim",
            "piezo_stage_driver")
ROOMS = ("piezo_identification.prediction", "piezo_models.hysteresis", "piezo_models.linear")


@pytest.mark.parametrize("name", PACKAGES + ROOMS)
def test_every_exported_name_is_there_and_the_lists_agree(name):
    package = importlib.import_module(name)
    tree = ast.parse(Path(package.__file__).read_text(encoding="utf-8"))
    (for_types,) = (node for node in tree.body if isinstance(node, ast.If))
    typed = {alias.name: node.module for node in for_types.body for alias in node.names}
    assert set(package.__all__) == typed.keys() <= set(dir(package))
    for exported, module in typed.items():
        assert getattr(package, exported) is getattr(importlib.import_module(module), exported)


@pytest.mark.parametrize("name", PACKAGES + ROOMS)
def test_exported_names_are_not_those_of_modules(name):
    # Importing the module first would put it in the place of the exported function.
    package = importlib.import_module(name)
    assert not {path.stem for path in Path(package.__file__).parent.iterdir()} & set(
        package.__all__)


@pytest.mark.parametrize("name", PACKAGES)
def test_importing_a_package_loads_no_library_and_says_that_it_is_typed(name):
    script = (f"import sys, {name}; "
              "print(*{'numba', 'numpy', 'scipy', 'rclpy'} & sys.modules.keys())")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                          check=True)
    assert done.stdout.split() == []
    assert Path(importlib.import_module(name).__file__).with_name("py.typed").is_file()
