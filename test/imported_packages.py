# SPDX-License-Identifier: BSD-3-Clause
"""What a module imports, found without parsing it, as to parse all sources takes seconds."""

import re
from functools import cache
from pathlib import Path

IMPORT = re.compile(r"^ *(?:from (\w+)[\w.]* import|import (\w+))\b", re.M)


@cache
def imported_packages(path: Path) -> frozenset[str]:
    """Return the names of the packages and libraries that a module imports."""
    return frozenset(match[1] or match[2]
                     for match in IMPORT.finditer(path.read_text(encoding="utf-8")))
