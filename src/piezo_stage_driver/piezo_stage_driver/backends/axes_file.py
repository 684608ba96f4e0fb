# SPDX-License-Identifier: BSD-3-Clause
"""Settings files of backends: of one axis, or of several by their names in `axes`."""

import re
from collections.abc import Collection, Mapping
from os import PathLike
from typing import TypeVar

from piezo_common.regular_file import UnreadableFile
from piezo_common.schema import Document, Part, SchemaError, parsed, violation
from piezo_common.schema.checking import quoted
from piezo_common.text_file import read_bounded_text

One = TypeVar("One", bound=Document)
Several = TypeVar("Several", bound=Document)


def load_axes_file(one: type[One], several: type[Several],
                   path: str | PathLike[str]) -> One | Several:
    """Read a file of one axis, or of several if it has `axes`.

    Raises `SchemaError` if it cannot be read, or an entry is unknown, missing or impossible.
    """
    try:
        text = read_bounded_text(path)
    except UnreadableFile as error:
        raise SchemaError(str(error), f"give a {one.TITLE}") from None
    if re.search(r"^axes:", text, re.MULTILINE):
        return parsed(several, text)
    return parsed(one, text)


def check_axes(axes: Mapping[str, Part], unique: Collection[str]) -> None:
    """Raise a violation, in a validator, if axes are named badly or share what each needs alone."""
    for axis in axes:
        if not re.fullmatch("[a-z][a-z0-9]*", axis):
            raise violation(f"has the name {quoted(axis)}", "give short ones such as x", "axes")
    for name in unique:
        if len({getattr(own, name) for own in axes.values()}) < len(axes):
            raise violation(f"name one {name} twice", "give each its own", "axes")
