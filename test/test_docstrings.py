# SPDX-License-Identifier: BSD-3-Clause
"""What is public in the numerics says what it does, takes and returns, in numpydoc's form."""

import ast
import re
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src"
MODULES = sorted(
    path for package in ("piezo_models", "piezo_identification", "piezo_controller",
                         "piezo_recorder", "piezo_client")
    for path in (SOURCE / package / package).rglob("*.py")
    if not path.stem.endswith(("_node", "_command")))
# Up to so many that must be given, a sentence may say it all.
SHORT = 3


def public(tree):
    """Public classes and functions, also those of public classes, with their owner."""
    for node in tree.body:
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and not node.name.startswith("_"):
            yield None, node
            if isinstance(node, ast.ClassDef):
                yield from ((node, part) for part in node.body
                            if isinstance(part, ast.FunctionDef) and not part.name.startswith("_"))


def parameters(node):
    """Names of a function's parameters, in order."""
    arguments = node.args
    return [argument.arg for argument in
            [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
            if argument.arg not in ("self", "cls")]


def documented(docstring, section):
    """Names that a section of a docstring explains, or None if there is no such section."""
    found = re.search(rf"^ *{section}\n *-+\n(.*?)(?=\n\n[ ]*\w[\w ]*\n *-{{3,}}|\Z)",
                      docstring, re.M | re.S)
    if not found:
        return None
    lines = found[1].expandtabs().splitlines()
    indent = min((len(line) - len(line.lstrip()) for line in lines if line.strip()), default=0)
    heads = [line.strip() for line in lines
             if line.strip() and len(line) - len(line.lstrip()) == indent]
    return [name.strip("* ") for head in heads for name in head.split(" : ")[0].split(",")]


def objections(path):
    """Yield what the docstrings of a module lack."""
    tree = ast.parse(path.read_text())
    for owner, node in public(tree):
        name = f"{owner.name}.{node.name}" if owner else node.name
        docstring = ast.get_docstring(node)
        if docstring is None:
            yield f"{name} has no docstring"
        elif isinstance(node, ast.FunctionDef):
            explained = documented(docstring, "Parameters")
            taken = parameters(node)
            required = len(taken) - len(node.args.defaults)
            if explained is None and required > SHORT and owner is None:
                yield f"{name} does not explain {', '.join(taken)}"
            elif explained is not None and not set(explained) <= {
                    *taken, *(argument.arg for argument in (node.args.vararg, node.args.kwarg)
                              if argument)}:
                yield f"{name} explains {', '.join(explained)}, but takes {', '.join(taken)}"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: f"{path.parent.name}.{path.stem}")
def test_docstrings_match_what_they_describe(path):
    assert ast.get_docstring(ast.parse(path.read_text()))
    assert list(objections(path)) == []


@pytest.mark.parametrize(("code", "objection"), [
    ("def f(a):\n    pass", "f has no docstring"),
    ('def f(a):\n    """Do.\n\n    Parameters\n    ----------\n    b : int\n    """',
     "f explains b, but takes a"),
    ('def f(a, b, c, d):\n    """Do."""', "f does not explain a, b, c, d"),
    ('class C:\n    """A."""\n    def f(self):\n        pass', "C.f has no docstring"),
])
def test_fault_of_a_docstring_is_found(tmp_path, code, objection):
    path = tmp_path / "module.py"
    path.write_text(code)
    assert list(objections(path)) == [objection]


def test_api_pages_begin_with_every_package():
    pages = (SOURCE.parent / "docs" / "api" / "index.rst").read_text()
    assert set(re.findall(r"^   (\w+)$", pages, re.M)) == {
        path.parent.name for path in SOURCE.glob("*/setup.py")}


def test_every_file_names_its_licence_first():
    files = [path for folder in ("src", "test", "benchmarks", "examples", "tools")
             for path in (SOURCE.parent / folder).rglob("*.py")]
    assert [path for path in files if not path.read_text().startswith(
        "# SPDX-License-Identifier: BSD-3-Clause\n")] == []
