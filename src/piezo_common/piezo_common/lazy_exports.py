# SPDX-License-Identifier: BSD-3-Clause
"""Names of a package that are imported at their first use (PEP 562)."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def lazy_exports(package: str, source: str,
                 ) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the functions ``__getattr__`` and ``__dir__`` of a package, from its name and file.

    A command that needs one name of a package then does not load the libraries of all others. The
    source of the package imports each name from its module under its one ``if``, for type checkers
    only.
    """
    tree = ast.parse(Path(source).read_text(encoding="utf-8"))
    homes = {alias.name: str(node.module) for block in tree.body if isinstance(block, ast.If)
             for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}

    def getter(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(homes[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    def lister() -> list[str]:
        return sorted({*vars(sys.modules[package]), *homes})

    return getter, lister
