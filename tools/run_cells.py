# SPDX-License-Identifier: BSD-3-Clause
"""Run a notebook, or the Python of a Markdown page, as a reader would: cell by cell.

    python tools/run_cells.py FILE [NAME=TEXT ...]

It needs no Jupyter. What the last line of a cell shows is printed, pictures by their size. A
NAME that a cell sets gets TEXT instead, such as another folder.
"""

import ast
import json
import re
import sys
from pathlib import Path


def main(arguments):
    """Run the cells of a file."""
    path, *settings = arguments
    changed = dict(setting.split("=", 1) for setting in settings)
    for shown in run_cells(cells_of(Path(path)), {"__name__": "__main__"}, changed):
        if shown is not None:
            form, content = shown
            print(f"[{form}, {len(content)} bytes]" if form == "png" else content)
    return 0


def cells_of(path):
    """Return the source of the Python cells of a notebook, or of the blocks of a page."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)
    return ["".join(cell["source"]) for cell in json.loads(text)["cells"]
            if cell["cell_type"] == "code"]


def run_cells(cells, namespace, changed=None):
    """Run cells in one namespace; return what each shows, None where it shows nothing.

    Parameters
    ----------
    cells : list of str
    namespace : dict
        Changed by the cells.
    changed : dict of str to str, optional
        What the cells set under a name is replaced by these.

    Returns
    -------
    list of (str, bytes or str) or None
        The richest form that a notebook would show: "png", "html" or "text".
    """
    shown = []
    for number, source in enumerate(cells, 1):
        body = ast.parse(source, f"cell {number}").body
        for line in body:
            if isinstance(line, ast.Assign) and ast.unparse(line.targets[0]) in (changed or {}):
                value = changed[ast.unparse(line.targets[0])]
                line.value = ast.copy_location(ast.Constant(value), line.value)
        last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
        exec(compile(ast.Module(body, []), f"cell {number}", "exec"), namespace)
        value = None if last is None else eval(
            compile(ast.Expression(last.value), f"cell {number}", "eval"), namespace)
        shown.append(None if value is None else display_of(value))
    return shown


def display_of(value):
    """Return the richest form in which a notebook shows a value."""
    for form in ("png", "html"):
        method = getattr(value, f"_repr_{form}_", None)
        if method is not None:
            return form, method()
    return "text", repr(value)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
