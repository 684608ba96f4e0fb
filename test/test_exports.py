# SPDX-License-Identifier: BSD-3-Clause
"""The names that the packages export are there, and cost nothing until they are used."""

import ast
import doctest
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest
from replaced import replaced
from short_identification import FEW_EFFECTS, FEW_POLES, WITHOUT_SEARCH

from piezo_identification.diagnosis import diagnose
from piezo_identification.diagnosis.diagnose import compare_effects

PACKAGES = ("piezo_identification", "piezo_models", "piezo_offline", "piezo_recorder", "piezo_sim",
            "piezo_stage_driver")
ROOMS = ("piezo_identification.prediction",)


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


EXAMPLES = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
WITHOUT_EXAMPLE = {
    "plot_residuals",  # a diagnosis of recordings takes long; docs/from_python.md has one
    "load_model", "load_axes_model", "save_axes_model",  # as those of piezo_offline
    "repair",  # it takes a recording of a recorder that was killed
}


@pytest.fixture
def compared_once(monkeypatch):
    """Compare the effects once for the examples that diagnose the same recording."""
    compared = {}

    def compare_once(model, recordings, *asked):
        key = tuple(each.displacement_um.tobytes() for each in recordings)
        if key not in compared:
            compared[key] = compare_effects(model, recordings, *asked)
        return compared[key]

    monkeypatch.setattr(diagnose, "compare_effects", compare_once)
    with replaced(*FEW_POLES, *WITHOUT_SEARCH, *FEW_EFFECTS):
        yield


@pytest.mark.filterwarnings("ignore:implausible")
@pytest.mark.usefixtures("compared_once")
@pytest.mark.parametrize("name", ["piezo_identification", "piezo_models", "piezo_offline",
                                  "piezo_recorder"])
def test_every_exported_function_has_an_example_that_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    package, names = importlib.import_module(name), {}
    functions = [getattr(package, exported) for exported in package.__all__]
    # In the order of a module, as those of steps go on from each other.
    functions = sorted((each for each in functions if inspect.isfunction(each)),
                       key=lambda each: (each.__module__, each.__code__.co_firstlineno))
    without = set()
    for function in functions:
        (test,) = doctest.DocTestFinder(recurse=False).find(function, function.__name__)
        if not test.examples:
            without.add(function.__name__)
        names |= vars(sys.modules[function.__module__])
        test.globs = names
        assert EXAMPLES.run(test, clear_globs=False).failed == 0
    assert without <= WITHOUT_EXAMPLE
