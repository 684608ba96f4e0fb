# SPDX-License-Identifier: BSD-3-Clause
"""The mutation check draws the same changes each time, and each changes what a module does."""

import ast
import importlib.util
import sys
from pathlib import Path

import pytest

PATH = Path(__file__).parents[1] / "benchmarks" / "mutation_check.py"


@pytest.fixture(scope="module")
def check():
    spec = importlib.util.spec_from_file_location("mutation_check", PATH)
    module = importlib.util.module_from_spec(spec)
    sys.modules["mutation_check"] = module
    spec.loader.exec_module(module)
    return module


def test_same_seed_draws_the_same_mutants_of_every_room(check, capsys):
    assert check.main(["--list", "--mutants", "5", "--seed", "2"]) == 0
    first = capsys.readouterr().out
    assert check.main(["--list", "--mutants", "5", "--seed", "2"]) == 0
    assert capsys.readouterr().out == first
    assert first.count("\n") == 5 * len(check.ROOMS)


@pytest.mark.parametrize(("code", "changed"), [
    ("a < b", "a <= b"), ("a + b", "a - b"), ("a and b", "a or b"), ("2.0", "3.0"),
    ("True", "False")])
def test_one_thing_is_changed(check, code, changed):
    node = ast.parse(code, mode="eval").body
    assert check.mutate(node) == f"{code} -> {changed}"


def test_messages_are_not_changed(check, tmp_path):
    path = tmp_path / "module.py"
    path.write_text("def f(a):\n    raise ValueError(f'{a + 1} is too large')\n")
    assert list(check.mutants_of("guards", path)) == []
