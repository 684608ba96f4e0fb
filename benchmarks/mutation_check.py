# SPDX-License-Identifier: BSD-3-Clause
"""Count the faults in the guards, the laws and the recorder that the unit tests let pass.

    python benchmarks/mutation_check.py [--mutants N] [--seed N] [--jobs N] [--room NAME] [--list]

A mutant is a copy of the package in which one comparison, sign, boolean operator, constant or
returned value is changed. The unit tests that cover the room run on it and should fail; a mutant on
which all of them pass has survived. Some survivors mean the same as the original or change a
message only, so the number is one to compare between two states of the tests, not to bring to zero.
"""

import argparse
import ast
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src"
LONGEST_RUN_S = 120
"""Of the processor, which an endless loop takes; other programs beside it do not count."""

ROOMS = {
    "guards": ("piezo_stage_driver/piezo_stage_driver/safety",
               ["piezo_stage_driver/test/safety", "piezo_stage_driver/test/engine"]),
    "laws": ("piezo_models/piezo_models/feedback_law",
             ["piezo_models/test/feedback_law", "piezo_stage_driver/test/engine"]),
    "recorder": ("piezo_recorder/piezo_recorder/writing", ["piezo_recorder/test/writing"]),
}
"""The rooms that are changed, and the tests that cover each."""

COMPARED = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
            ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn,
            ast.NotIn: ast.In}
COMPUTED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
            ast.And: ast.Or, ast.Or: ast.And}


class Mutant(NamedTuple):
    """One change: the file, the node by its place in `ast.walk`, and what is done to it."""

    room: str
    path: Path
    node: int
    line: int
    change: str


def main(arguments: list[str] | None = None) -> int:
    """Draw mutants, run the tests on each and print the survivors and a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mutants", type=int, default=20, help="of each room (default 20)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1, help="how many run at the same time")
    parser.add_argument("--room", choices=ROOMS, action="append")
    parser.add_argument("--list", action="store_true", help="print the mutants, run nothing")
    options = parser.parse_args(arguments)
    drawn = {room: draw(room, options.mutants, options.seed) for room in options.room or ROOMS}
    if options.list:
        for mutant in sum(drawn.values(), []):
            print(described(mutant))
        return 0
    for room in drawn:
        if not passes(room, None):
            print(f"mutation_check: the tests of the {room} fail without any change; "
                  "mend them first", file=sys.stderr)
            return 1
    print("| room | mutants | survived |\n|---|---|---|")
    for room, mutants in drawn.items():
        with ThreadPoolExecutor(options.jobs) as pool:
            survived = list(pool.map(lambda mutant: passes(mutant.room, mutant), mutants))
        print(f"| {room} | {len(mutants)} | {sum(survived)} |", flush=True)
        for mutant, passed in zip(mutants, survived, strict=True):
            if passed:
                print(f"  survived: {described(mutant)}", file=sys.stderr, flush=True)
    return 0


def draw(room: str, count: int, seed: int) -> list[Mutant]:
    """Draw changes of a room's modules, the same ones for the same sources and seed."""
    found = [mutant for path in sorted((SOURCE / ROOMS[room][0]).glob("*.py"))
             for mutant in mutants_of(room, path)]
    return sorted(random.Random(seed).sample(found, min(count, len(found))))


def mutants_of(room: str, path: Path) -> Iterator[Mutant]:
    """List every change that can be made in the functions of a module."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inside = {id(part) for function in ast.walk(tree)
              if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
              for statement in function.body for part in ast.walk(statement)}
    raised = {id(part) for node in ast.walk(tree) if isinstance(node, ast.Raise | ast.JoinedStr)
              for part in ast.walk(node)}  # messages
    for number, node in enumerate(ast.walk(tree)):
        if id(node) in inside and id(node) not in raised and (change := mutate(node)):
            yield Mutant(room, path, number, node.lineno, change)


def mutate(node: ast.AST) -> str | None:
    """Change a node in place and say how; do nothing and return None if it is of another kind."""
    before = ast.unparse(node) if isinstance(node, ast.expr | ast.stmt) else ""
    match node:
        case ast.Compare(ops=[operator, *_]) if type(operator) in COMPARED:
            node.ops[0] = COMPARED[type(operator)]()
        case ast.BinOp(op=operator) | ast.BoolOp(op=operator) if type(operator) in COMPUTED:
            node.op = COMPUTED[type(operator)]()
        case ast.UnaryOp(op=ast.USub()):
            node.op = ast.UAdd()
        case ast.Constant(value=bool()):
            node.value = not node.value
        case ast.Constant(value=int() | float()):
            node.value = node.value + 1
        case ast.Return(value=ast.expr()) if not (
                isinstance(node.value, ast.Constant) and node.value.value is None):
            node.value = ast.Constant(None)
        case _:
            return None
    return f"{before} -> {ast.unparse(node)}".replace("\n", " ")


def described(mutant: Mutant) -> str:
    """Say where a mutant differs, and how."""
    return f"{mutant.path.relative_to(SOURCE)}:{mutant.line}: {mutant.change}"


def passes(room: str, mutant: Mutant | None) -> bool:
    """Run the tests of a room on a copy of its package in which one thing is changed."""
    folder, tests = ROOMS[room]
    package = Path(folder).parts[1]
    with tempfile.TemporaryDirectory() as directory:
        copy = Path(directory) / package
        shutil.copytree(SOURCE / package / package, copy)
        if mutant is not None:
            changed = copy / mutant.path.relative_to(SOURCE / package / package)
            tree = ast.parse(changed.read_text(encoding="utf-8"))
            mutate(list(ast.walk(tree))[mutant.node])
            # Numba does not notice that a function has changed which another file calls.
            if "njit" in changed.read_text(encoding="utf-8"):
                for kept in copy.rglob("*.nb[ci]"):
                    kept.unlink()
            changed.write_text(ast.unparse(tree), encoding="utf-8")
        environment = os.environ | {
            "PYTHONPATH": f"{directory}:{os.environ.get('PYTHONPATH', '')}",
            "HYPOTHESIS_STORAGE_DIRECTORY": f"{directory}/hypothesis"}
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider",
                   "--hypothesis-seed=0", *(str(SOURCE / test) for test in tests)]
        limit = (LONGEST_RUN_S, LONGEST_RUN_S)
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, check=False,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, limit))
    return done.returncode == 0


if __name__ == "__main__":
    sys.exit(main())
