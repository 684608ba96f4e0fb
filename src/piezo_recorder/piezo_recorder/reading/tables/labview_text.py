# SPDX-License-Identifier: BSD-3-Clause
"""Preamble of a LabVIEW measurement file (.lvm), which describes the table below it."""

from collections.abc import Sequence
from dataclasses import dataclass

FIRST_LINE = "LabVIEW Measurement"
TIME = "X_Value"

_SEPARATORS = {"Tab": "\t", "Comma": ","}


@dataclass(frozen=True)
class LabviewPreamble:
    """Entries of a preamble that are needed to read the table."""

    delimiter: str

    units: tuple[str, ...]
    """Units of the channels, in their order."""
    period_s: float
    """Distance of rows (s); 0 if it is not given."""
    has_time: bool
    """Whether the first column holds the time of each row; it is empty otherwise."""


def labview_preamble(lines: Sequence[str]) -> LabviewPreamble | None:
    """Read the preamble of a LabVIEW measurement file; None for any other file."""
    if not lines or not lines[0].startswith(FIRST_LINE):
        return None
    rest = lines[0][len(FIRST_LINE):]
    delimiter = "," if rest.startswith(",") else "\t"
    fields: dict[str, list[str]] = {}
    for line in lines[1:]:
        name, *values = [cell.strip() for cell in line.split(delimiter)]
        if name == TIME:
            break
        fields[name] = values
    delimiter = _SEPARATORS.get(_first(fields, "Separator"), delimiter)
    period = _first(fields, "Delta_X").replace(",", ".")
    try:
        period_s = float(period or 0.0)
    except ValueError:
        period_s = 0.0
    return LabviewPreamble(delimiter, tuple(fields.get("Y_Unit_Label", ())), period_s,
                           _first(fields, "X_Columns") != "No")


def _first(fields: dict[str, list[str]], name: str) -> str:
    return next(iter(fields.get(name, ())), "")
