# SPDX-License-Identifier: BSD-3-Clause
"""What the tools have in common that write a page of docs from the sources."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]


def write_or_check(path: Path, made: Callable[[], str], description: str,
                   arguments: list[str] | None = None) -> int:
    """Write a page, or with ``--check`` only say whether it is up to date; return the status."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing; status 1 if outdated")
    options = parser.parse_args(arguments)
    text = made()
    if not options.check:
        path.write_text(text, encoding="utf-8")
    elif not path.is_file() or path.read_text(encoding="utf-8") != text:
        print(f"{path.relative_to(ROOT)} is outdated: run make tables", file=sys.stderr)
        return 1
    return 0
