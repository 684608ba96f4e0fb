# SPDX-License-Identifier: BSD-3-Clause
"""Optional libraries, and how to install them."""

import sys
from pathlib import Path


def how_to_install(package: str, extra: str) -> str:
    """Return how to install a missing library, by its name for `pip`, of an extra of the suite."""
    of_setup = (Path(sys.prefix) / "stamp").exists()  # written by tools/setup
    typed = "`make extras`" if of_setup else (
        f"`pip install {package}`, or the extra `pip install '.[{extra}]'` of the suite")
    return f"install it ({typed})"
