# SPDX-License-Identifier: BSD-3-Clause
"""Write docs/constants.md: the numbers that decide in identification and diagnosis.

python tools/constants_table.py [--check]

Those are the numeric constants of modules, and the numeric defaults of settings. Sources are read,
not run.
"""

import ast
import re
import sys
from collections.abc import Iterator
from typing import NamedTuple

from generated_page import ROOT, write_or_check

PAGE = ROOT / "docs" / "constants.md"
PACKAGE = ROOT / "src" / "piezo_identification" / "piezo_identification"
OTHERS = {"commands", "node", "report", "experiments"}
"""Rooms whose numbers lay out pages and waveforms, and decide nothing of a model."""

SETTINGS = re.compile(r"(Settings|Criteria|Needs)$")
UNITS = {"um": "um", "v": "V", "s": "s", "hz": "Hz", "rad_per_s": "rad/s", "um_per_s": "um/s",
         "percent": "%", "v_per_s": "V/s", "um_per_v": "um/V"}
COUNTED = {"in sample periods": "sample periods", "sample periods": "sample periods",
           "standard deviations": "standard deviations", "samples": "samples", "rows": "rows"}
SOURCE = re.compile(
    r"\b(1[89]\d\d|20\d\d|set on|measured (?:data|stage|set)s?|drawn|seeds?|thesis)\b|docs/|`make ")

HEAD = """\
# Constants that decide

Written by `make docs` from the sources; do not edit. `make constants` writes this page alone.

{count} numbers of identification and diagnosis decide something; {known} of them say what they were
set on, or where they come from. The unit is 1 where none is given.
"""


class Constant(NamedTuple):
    """A number that decides: its name, value and unit, what it means, and what it was set on."""

    name: str
    value: str
    unit: str
    meaning: str
    source: str


def main(arguments: list[str] | None = None) -> int:
    """Write the page, or with ``--check`` only say whether it is up to date."""
    return write_or_check(PAGE, page, __doc__, arguments)


def page() -> str:
    """Return the page."""
    parts, everything = [], list[Constant]()
    for path in sorted(PACKAGE.rglob("*.py")):
        file = path.relative_to(PACKAGE)
        found = [] if OTHERS.intersection(file.parts) else list(
            constants(path.read_text(encoding="utf-8")))
        if found:
            everything += found
            rows = [f"| `{name}` | {value} | {unit} | {meaning} | {source} |"
                    for name, value, unit, meaning, source in found]
            parts.append("\n".join([
                f"\n## {file.with_suffix('').as_posix()}\n",
                "| constant | value | unit | meaning | set on |", "|---|---|---|---|---|", *rows]))
    known = sum(bool(each.source) for each in everything)
    return HEAD.format(count=len(everything), known=known) + "\n".join(parts) + "\n"


def constants(text: str) -> Iterator[Constant]:
    """Yield the numbers that a module decides by."""
    body = ast.parse(text).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef) and SETTINGS.search(node.name):
            yield from _of_settings(node)
        elif isinstance(node, ast.Assign):
            yield from _of_module(node, _docstring(after))


def _of_module(node: ast.Assign, told: str) -> Iterator[Constant]:
    target = node.targets[0]
    many = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
    pairs = zip(target.elts, node.value.elts, strict=True) if many else [(target, node.value)]
    for name, value in pairs:
        if isinstance(name, ast.Name) and name.id.lstrip("_").isupper() and _is_number(value):
            yield _constant(name.id, value, told)


def _of_settings(node: ast.ClassDef) -> Iterator[Constant]:
    entries, above, end = dict[str, str](), list[str](), 0
    for line in node.body:
        # A text is of the fields directly above it, up to another text or an empty line.
        above, end = above if line.lineno == end + 1 else [], line.end_lineno
        if isinstance(line, ast.AnnAssign):
            above.append(ast.unparse(line.target))
        else:
            entries |= dict.fromkeys(above, _docstring(line))
            above = []
    for field in node.body:
        if isinstance(field, ast.AnnAssign) and field.value and _is_number(field.value):
            name = ast.unparse(field.target)
            yield _constant(f"{node.name}.{name}", field.value, entries.get(name, ""))


def _constant(name: str, value: ast.expr, told: str) -> Constant:
    text = " ".join(told.split()).replace("|", "\\|")
    sentences = re.split(r"(?<=[.;:]) (?=[A-Z0-9(])", text)
    source = " ".join(each for each in sentences if SOURCE.search(each))
    suffix = next((unit for end, unit in sorted(UNITS.items(), key=lambda pair: -len(pair[0]))
                   if name.lower().endswith(f"_{end}")), "")
    unit = suffix or next((unit for words, unit in COUNTED.items() if (
        text.lower().startswith(words) or words.startswith("in ") and words in text.lower())), "1")
    meaning = " ".join(each for each in sentences if each not in source)
    return Constant(name, f"`{ast.unparse(value)}`", unit, meaning, source)


def _is_number(node: ast.expr) -> bool:
    if isinstance(node, ast.Tuple):
        return bool(node.elts) and all(map(_is_number, node.elts))
    if isinstance(node, ast.UnaryOp | ast.BinOp):
        return all(map(_is_number, (each for each in ast.iter_child_nodes(node)
                                    if isinstance(each, ast.expr))))
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def _docstring(node: ast.stmt | None) -> str:
    is_text = (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
               and isinstance(node.value.value, str))
    return node.value.value if is_text else ""


if __name__ == "__main__":
    sys.exit(main())
