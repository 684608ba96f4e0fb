# SPDX-License-Identifier: BSD-3-Clause
"""Write docs/errors.md: every refusal and trip, as the sources tell it.

    python tools/error_table.py [--check]

Texts are read, not run: what is filled in at run time stands in angle brackets. A text says what is
wrong, then what to do, and the table parts it there.
"""

import ast
import re
import sys

from generated_page import ROOT, write_or_check

PAGE = ROOT / "docs" / "errors.md"
# Calls that put the path, the field, the problem and the cure together themselves.
REFUSERS = {"refuse", "_refuse"}
# Errors that are given problem, cure and perhaps the field.
PARTED = {"SchemaError", "violation"}
# Results with a problem and its cure, which another function raises.
RETURNED = {"Violation"}
TRIPS = {"stop"}
# Nodes without others that tell anything.
LEAVES = (ast.Name, ast.Constant, ast.expr_context, ast.operator, ast.cmpop, ast.alias)
# Of a Python caller who broke a rule of the language; no user reads them.
OF_PYTHON = {"StopIteration", "AttributeError", "SystemExit"}

HEAD = """\
# Errors

Written by `make docs` from the sources; do not edit. What is filled in at run time stands in
angle brackets.

Commands print one line on stderr, `NAME: text`, and end with status 2; so do nodes that cannot
start. A goal or a service that is refused carries the text in `message`, and the node logs it. In
Python the text is that of the exception.
"""
TRIP_HEAD = """\
## Trips of the stage

What stops the stage by itself. The text is in `/diagnostics`, in the log, and in the answer to
whoever asks the stage for something next. **Cure:** mend the cause, then call `reset`; the stage
stays at rest until then.

| text | what it watches | module |
|---|---|---|
"""
REFUSAL_HEAD = """\
| what is wrong | what to do | module |
|---|---|---|
"""


def main(arguments=None):
    """Write the page, or with ``--check`` only say whether it is up to date."""
    return write_or_check(PAGE, page, __doc__, arguments)


def page():
    """Return the page."""
    parts = [HEAD]
    trips = [row for path in modules("piezo_stage_driver") for row in trips_of(path)]
    parts.append(TRIP_HEAD + "".join(sorted(trips)))
    for package in sorted(path.parent.name for path in ROOT.glob("src/*/setup.py")):
        rows = [row for path in modules(package) for row in refusals_of(path)]
        if rows:
            parts.append(f"## {package}\n\n{REFUSAL_HEAD}" + "".join(dict.fromkeys(rows)))
    return "\n".join(parts)


def modules(package):
    """Modules of a package, in order."""
    return sorted((ROOT / "src" / package / package).rglob("*.py"))


def refusals_of(path):
    """Rows of the refusals in a module, in the order of their lines."""
    nodes = statements(ast.parse(path.read_text(encoding="utf-8")))
    usual_cure = cure_of_refuser(nodes)
    refusing = [node for node in nodes if isinstance(node, (ast.Raise, ast.Call, ast.Assign))]
    for node in sorted(refusing, key=lambda node: node.lineno):
        text = refusal(node)
        if text and re.sub("<.*?>|[^a-z]", "", text):
            problem, cure = parted(text)
            if isinstance(node, ast.Call):
                cure = cure or usual_cure
            yield row(problem, cure, f"`{module_name(path)}`")


def cure_of_refuser(nodes):
    """What a module's own function of `REFUSERS` says to do whatever the problem; may be empty."""
    for node in nodes:
        if isinstance(node, ast.FunctionDef) and node.name in REFUSERS:
            for text in filter(None, map(refusal, statements(node))):
                cure = parted(text)[1]
                return "" if "<" in cure else cure
    return ""


def refusal(node):
    """Text that a statement refuses with, or None."""
    if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
        if ast.unparse(node.exc.func) in OF_PYTHON:
            return None
        if called(node.exc) in PARTED and len(node.exc.args) > 1:
            texts = [template(argument) or f"<{ast.unparse(argument)}>"
                     for argument in node.exc.args]
            field = texts[2] + " " if len(texts) > 2 else ""
            return f"{field}{texts[0]}; {texts[1]}"
        inner = [keyword.value for argument in node.exc.args if isinstance(argument, ast.Call)
                 for keyword in argument.keywords if keyword.arg == "message"]
        return next(filter(None, map(template, [*node.exc.args, *inner])), None)
    if isinstance(node, ast.Call) and called(node) in RETURNED:
        return "; ".join(template(argument) for argument in node.args[:2])
    if isinstance(node, ast.Call) and called(node) in REFUSERS:
        texts = [template(argument) or f"<{ast.unparse(argument)}>" for argument in node.args]
        if len(texts) < 2:
            return None
        return "; ".join([" ".join(texts[:2]), *texts[2:]])
    if isinstance(node, ast.Assign) and getattr(node.targets[0], "attr", "") == "message":
        return template(node.value)
    return None


def trips_of(path):
    """Rows of what stops the stage by itself: texts of guards and of calls of ``stop``."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for owner in statements(tree):
        if isinstance(owner, ast.ClassDef):
            watched = (ast.get_docstring(owner) or "").splitlines()[:1]
            for node in statements(owner):
                text = None
                if isinstance(node, ast.Return) and path.stem in ("guards", "law_guard"):
                    text = node.value and template(node.value)
                elif isinstance(node, ast.Call) and called(node) in TRIPS and node.args:
                    text = template(node.args[0])
                if text:
                    yield row(text, *watched, f"`{module_name(path)}`")


def statements(tree):
    """All nodes of a tree below its root, except names and constants, which are most of them."""
    found = [tree]
    for node in found:
        found += [child for child in ast.iter_child_nodes(node) if not isinstance(child, LEAVES)]
    return [node for node in found[1:] if hasattr(node, "lineno")]


def called(node):
    """Last part of the name of the function that is called."""
    if isinstance(node.func, ast.Attribute):
        return node.func.attr
    return node.func.id if isinstance(node.func, ast.Name) else ""


def template(node):
    """The text of an expression, with what is filled in between angle brackets, or None."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) and node.value else None
    if isinstance(node, ast.JoinedStr):
        return "".join(part.value if isinstance(part, ast.Constant) else
                       f"<{ast.unparse(part.value)}>" for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        left, right = template(node.left), template(node.right)
        return left and right and left + right
    return None


def parted(text):
    """What is wrong, and what to do, of a text that says both."""
    outside = re.sub(r"<[^<>]*>", lambda match: "x" * len(match[0]), text)
    for mark in ("; ", ": "):
        at = outside.rfind(mark)
        if at > 0:
            return text[:at], text[at + len(mark):].rstrip(".")
    return text, ""


def row(*cells):
    """One row of a table."""
    return "| " + " | ".join(
        " ".join(cell.split()).replace("|", "\\|").replace("<", "‹").replace(">", "›")
        for cell in cells) + " |\n"


def module_name(path):
    """Name of a module below its package."""
    return ".".join(path.relative_to(ROOT / "src").with_suffix("").parts[2:])


if __name__ == "__main__":
    sys.exit(main())
