# SPDX-License-Identifier: BSD-3-Clause
"""Libraries that not every user needs, and how to get them."""

import sys
from pathlib import Path


def how_to_install(package: str, extra: str) -> str:
    """Return what to type where a library of an extra of the suite is missing.

    Parameters
    ----------
    package : str
        As `pip install` takes it.
    extra : str
        Of the suite's ``pyproject.toml``.
    """
    of_setup = (Path(sys.prefix) / "stamp").exists()  # as tools/setup leaves it
    typed = "`make extras`" if of_setup else (
        f"`pip install {package}`, or the extra `pip install '.[{extra}]'` of the suite")
    return f"install it ({typed})"
