# SPDX-License-Identifier: BSD-3-Clause
"""Contents of a cell of a text table: a number, a time, a text, or nothing."""

import math
import re

import numpy as np

from piezo_common.arrays import FloatArray

MISSING = {"", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---"}
"""Texts for a missing value, in lower case."""

DAY_S = 86_400.0

_FORTRAN = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+))[dD]([-+]?\d+)")
_GROUPED = {
    decimal: re.compile(rf"[-+]?[1-9]\d{{0,2}}(?:{mark}\d{{3}})+(?:{re.escape(decimal)}\d+)?")
    for decimal, mark in ((".", "[, '’]"), (",", r"[. '’]"))}
"""Numbers with thousands separators, by their decimal mark."""

_DATE = r"(?:(\d{4})[-/.](\d\d?)[-/.](\d\d?)|(\d\d?)([./])(\d\d?)[./](\d{4}))"
_CLOCK = re.compile(
    rf"(?:{_DATE}[ T]\s*)?(\d{{1,2}}):(\d\d):(\d\d(?:[.,]\d+)?)\s*([AaPp][Mm])?"
    r"\s*(Z|[-+]\d\d:?\d\d)?")


def kind_of(cell: str, decimal: str, grouped: bool = False) -> str:
    """Return what a cell holds: ``number``, ``clock``, ``text`` or ``empty``.

    The decimal mark of the file is ``.`` or ``,``. If `grouped`, a single mark before three digits
    is a thousands separator, as in 1,570; if the file does not show its decimal mark elsewhere, it
    may be the decimal mark.
    """
    if not math.isnan(number_of(cell, decimal, grouped)):  # first, as most cells are numbers
        return "number"
    if cell.lower() in MISSING:
        return "empty"
    return "clock" if _CLOCK.fullmatch(cell) else "text"


def number_of(cell: str, decimal: str, grouped: bool = False) -> float:
    """Return the number in a cell; NaN if there is none. See `kind_of`."""
    if is_grouped(cell, decimal):
        digits = re.sub("[ '’]", "", cell)
        marks = [mark for mark in digits if mark in ".,"]
        if grouped or len(digits) < len(cell) or len(marks) > 1:
            other = "," if decimal == "." else "."
            return float(digits.replace(other, "").replace(",", "."))
    text = cell if decimal == "." else cell.replace(",", ".")
    found = _FORTRAN.fullmatch(text)
    try:
        return math.nan if "_" in text else float(f"{found[1]}e{found[2]}" if found else text)
    except ValueError:
        return math.nan


def is_grouped(cell: str, decimal: str) -> bool:
    """Return whether a number may have thousands separators."""
    return bool(_GROUPED[decimal].fullmatch(cell))


def is_time_of_day(cell: str) -> bool:
    """Return whether a cell holds a time without a date, which restarts at midnight."""
    found = _CLOCK.fullmatch(cell)
    return found is not None and found[1] is None and found[4] is None


def across_midnight(time_s: FloatArray) -> FloatArray:
    """Return times of the day that continue to rise across midnight."""
    begins = np.diff(time_s) < -0.5 * DAY_S
    return time_s + DAY_S * np.concatenate([[0], np.cumsum(begins)])


def clock_seconds(cell: str) -> tuple[float, float]:
    """Return the midnight before a date with time, and the time since then, both in seconds.

    Separate values keep the nanoseconds. For a time of the day the midnight is 0. Both are NaN if
    the cell is neither. In 3/4/2026 the month comes first, in 3.4.2026 the day.
    """
    found = _CLOCK.fullmatch(cell)
    if not found:
        return math.nan, math.nan
    year, month, day = found[1], found[2], found[3]
    if found[4]:
        day, month, year = found[4], found[6], found[7]
        if found[5] == "/" and int(month) > 12 or found[5] == "/" and int(day) <= 12:
            day, month = month, day
    try:
        date = f"{int(year):04}-{int(month):02}-{int(day):02}" if year else "1970-01-01"
        midnight_s = float(np.datetime64(date, "s").astype(int))
    except ValueError:
        return math.nan, math.nan
    hour = int(found[8])
    if found[11]:
        hour = hour % 12 + 12 * (found[11].lower() == "pm")
    zone = found[12]
    offset_s = 0.0
    if zone and zone != "Z":
        digits = zone[1:].replace(":", "")
        offset_s = float(zone[0] + "1") * (3600.0 * int(digits[:2]) + 60.0 * int(digits[2:]))
    seconds = float(found[10].replace(",", "."))
    return midnight_s, 3600.0 * hour - offset_s + 60.0 * int(found[9]) + seconds
