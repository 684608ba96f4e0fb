# SPDX-License-Identifier: BSD-3-Clause
"""Absolute paths for the nodes, which may work in another folder than the caller."""

import copy
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from piezo_interfaces.msg import Reference

AnyPath = str | os.PathLike[str]
"""A path in any form; an empty string for none."""

ONE_PATH = ("directory", "model", "extended_model", "holdout", "learned", "controller")
SEVERAL_PATHS = ("recordings",)
ONE_REFERENCE = ("reference",)
SEVERAL_REFERENCES = ("then",)


def absolute(path: AnyPath) -> str:
    """Return the absolute path; an empty one, for none, stays empty."""
    path = os.fspath(path)
    return path and str(Path(path).absolute())


def with_absolute_paths(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of the fields of a goal or a request with all paths made absolute.

    Paths may be path-like; references are messages or other objects with a ``file``.
    """
    made = dict(fields)
    for names, convert in ((ONE_PATH, absolute), (ONE_REFERENCE, _with_absolute_file)):
        made |= {name: convert(made[name]) for name in names if name in made}
    for names, convert in ((SEVERAL_PATHS, absolute), (SEVERAL_REFERENCES, _with_absolute_file)):
        made |= {name: [*map(convert, made[name])] for name in names if name in made}
    return made


def _with_absolute_file(reference: Reference) -> Reference:
    reference = copy.copy(reference)
    reference.file = absolute(reference.file)
    return reference
