# SPDX-License-Identifier: BSD-3-Clause
"""Export names of a package that are imported when they are first used (PEP 562)."""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_exports(package: str, homes: Mapping[str, str],
                 ) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the functions ``__getattr__`` and ``__dir__`` of a package.

    A command that needs one name of a package then does not wait for the libraries of all others.

    Parameters
    ----------
    package : str
        Name of the package, ``__name__``.
    homes : mapping of str to str
        Module of each name, below the package.

    Returns
    -------
    getter, lister : callable
        To be named ``__getattr__`` and ``__dir__`` in the package.
    """
    def getter(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{homes[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    def lister() -> list[str]:
        return sorted({*vars(sys.modules[package]), *homes})

    return getter, lister
