# SPDX-License-Identifier: BSD-3-Clause
"""Gwyddion Simple Field files (``.gsf``): one map of numbers over an area, with units."""

import re
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.regular_file import UnreadableFile, open_regular

MAGIC = b"Gwyddion Simple Field 1.0\n"
LARGEST_BYTES = 1_000_000_000
MICRO = 1e-6
"""Lengths of a file are in metres, ours in um."""


class FieldError(ValueError):
    """A file is no Gwyddion Simple Field that can be used; the message gives path and cure."""


@dataclass(frozen=True, eq=False)
class Field:
    """A map of numbers over a rectangle of equal pixels."""

    values: FloatArray
    """Shape (rows, columns); the first row has the lowest y, and is the upper one in Gwyddion."""
    corner_um: tuple[float, float]
    """Lowest x and y of the rectangle, at the edges of the pixels."""
    size_um: tuple[float, float]
    """Size along x and y."""
    unit: str = ""
    """Unit of the values; that of heights is um."""
    title: str = ""

    def pixels_at(self, position_um: FloatArray) -> FloatArray:
        """Return positions along x and y, (N, 2), as fractional rows and columns, (2, N)."""
        shape = np.array(self.values.shape[::-1])
        pixels = (position_um - self.corner_um) / self.size_um * shape - 0.5
        return np.ascontiguousarray(pixels.T[::-1])


def write_gsf(path: str | PathLike[str], field: Field) -> None:
    """Write a field; its values are stored as numbers of 32 bits."""
    rows, columns = field.values.shape
    in_um = field.unit == "um"
    entries = {
        "XRes": columns, "YRes": rows,
        **{f"{axis}{name}": f"{MICRO * value:.9g}" for name, values in (
            ("Real", field.size_um), ("Offset", field.corner_um))
            for axis, value in zip("XY", values, strict=True)},
        "XYUnits": "m", "ZUnits": "m" if in_um else field.unit, "Title": field.title}
    header = MAGIC + "".join(
        f"{name} = {value}\n" for name, value in entries.items() if value != "").encode()
    values = (MICRO if in_um else 1.0) * field.values
    # One to four zeros, so that the numbers begin at a multiple of four.
    Path(path).write_bytes(header + bytes(4 - len(header) % 4)
                           + values.astype("<f4").tobytes())


def read_gsf(path: str | PathLike[str]) -> Field:
    """Read a field; raise `FieldError` if the file is of another kind, or incomplete."""
    try:
        with open_regular(path, LARGEST_BYTES) as file:
            content = file.readall()
    except UnreadableFile as error:
        raise FieldError(f"{path} {error}: give a Gwyddion Simple Field (.gsf)") from None
    header = content.partition(b"\0")[0]
    entries = dict(re.findall(r"^(\w+) *= *(.*?) *$", header.decode(errors="replace"), re.M))
    try:
        rows, columns = int(entries["YRes"]), int(entries["XRes"])
        size, corner = (
            tuple(float(entries.get(f"{axis}{name}", default)) / MICRO for axis in "XY")
            for name, default in (("Real", "1"), ("Offset", "0")))
        begin = len(header) + 4 - len(header) % 4
        values = np.frombuffer(content, "<f4", rows * columns, begin).astype(float)
    except (KeyError, ValueError):
        raise FieldError(f"{path} is no complete Gwyddion Simple Field: save it as .gsf "
                         "again") from None
    if entries.get("XYUnits", "m") != "m" or min(size) <= 0.0 or not content.startswith(MAGIC):
        raise FieldError(f"{path} has no area in metres: give its size, and XYUnits = m")
    in_um = entries.get("ZUnits") == "m"
    return Field(values.reshape(rows, columns) / (MICRO if in_um else 1.0),
                 (corner[0], corner[1]), (size[0], size[1]),
                 "um" if in_um else entries.get("ZUnits", ""), entries.get("Title", ""))
