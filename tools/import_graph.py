# SPDX-License-Identifier: BSD-3-Clause
"""List which room imports which: docs/pictures/rooms.txt.

    python tools/import_graph.py [--check]

A room is a folder of a package that holds modules.
"""

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

from generated_page import ROOT, write_or_check

LIST = ROOT / "docs" / "pictures" / "rooms.txt"
NOT_LISTED = "piezo_interfaces"  # messages, which CMake makes into modules

IMPORT = re.compile(r"^ *(?:from [\w.]+ import (?:\([^)]*\)|.+)|import .+)$", re.M)
"""Of one statement: to parse all of the sources takes a second."""

Edges = dict[tuple[str, str], int]


def main(arguments: list[str] | None = None) -> int:
    """Write the list, or with ``--check`` only say whether it is up to date."""
    return write_or_check(
        LIST, lambda: listed(imports_between_rooms(ROOT / "src")), __doc__, arguments)


def module_files(source: Path) -> dict[str, Path]:
    """Find the modules of all packages by their dotted names."""
    found = {}
    for path in sorted(source.glob("*/piezo_*/**/*.py")):
        parts = path.relative_to(source).with_suffix("").parts[1:]
        found[".".join(parts).removesuffix(".__init__")] = path
    return found


def room_of(path: Path, source: Path) -> str:
    """Name the room of a module, such as ``piezo_models/effects``."""
    return path.relative_to(source).parent.as_posix().partition("/")[2]


def imports_between_rooms(source: Path) -> Edges:
    """Count the imports from one room to another, wherever in a module they stand."""
    files = module_files(source)
    counts: Edges = defaultdict(int)
    for path in files.values():
        room = room_of(path, source)
        for name in imported(path):
            while name not in files and "." in name:
                name = name.rpartition(".")[0]
            if name in files and room_of(files[name], source) != room:
                counts[room, room_of(files[name], source)] += 1
    return dict(sorted(counts.items()))


def imported(path: Path) -> Iterable[str]:
    """Yield the dotted names of our own that a module imports."""
    for found in IMPORT.findall(path.read_text(encoding="utf-8")):
        node, names = ast.parse(found.strip()).body[0], []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        yield from (name for name in names
                    if name.startswith("piezo_") and not name.startswith(NOT_LISTED))


def listed(imports: Edges) -> str:
    """Write the list: each room, and the rooms that it imports."""
    lines = ["# Written by `make docs` from the sources; do not edit.",
             "# Each room, and the rooms that its modules import."]
    for above in dict.fromkeys(above for above, _ in imports):
        lines += ["", above, *(f"    -> {below}" for room, below in imports if room == above)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
