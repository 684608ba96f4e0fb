# SPDX-License-Identifier: BSD-3-Clause
"""Run an executable at its new place, and print where that is."""

import os
import sys
from pathlib import Path
from typing import NoReturn

from ament_index_python.packages import PackageNotFoundError, get_package_prefix


def forward(package: str, executable: str) -> NoReturn:
    """Replace this process by an executable of another package, with the same arguments.

    It exits with status 2 if that package is not installed.
    """
    print(f"{executable} has moved: ./run {package} {executable}", file=sys.stderr, flush=True)
    try:
        path = Path(get_package_prefix(package), "lib", package, executable)
    except PackageNotFoundError:
        print(f"{executable}: the package {package} is not installed: build it", file=sys.stderr)
        sys.exit(2)
    os.execv(path, [str(path), *sys.argv[1:]])
