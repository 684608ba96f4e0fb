# SPDX-License-Identifier: BSD-3-Clause
"""Frequency responses in the text formats of analysers and other programs."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_recorder.reading.tables.delimited_text import read_text_table, text_columns
from piezo_recorder.reading.tables.table import Table, listing, no_progress
from piezo_recorder.reading.units import UNITS, name_and_unit, plain, signal_of_unit

WORDS = {
    "frequency": {"frequency", "freq", "frequenz", "fréquence", "f", "hz", "khz"},
    "real": {"re", "real", "realteil"},
    "imaginary": {"im", "imag", "imaginary", "imaginärteil"},
    "phase": {"phase", "phi", "arg", "angle", "argument", "deg"},
    "magnitude": {"magnitude", "mag", "gain", "amplitude", "amp", "abs", "modulus", "betrag", "db"},
}
"""Words that identify columns; the first match counts, so that gain_re is a real part."""

TO_HZ = {"hz": 1.0, "khz": 1e3, "rad/s": 0.5 / np.pi}
TO_RAD = {"rad": 1.0, "deg": np.pi / 180.0, "degree": np.pi / 180.0, "degrees": np.pi / 180.0,
          "°": np.pi / 180.0}

_PER = re.compile(r"(.*)_(\w+)_per_(v|s)", re.I)
_TOUCHSTONE = re.compile(r"#\s*(k?hz)\s+\w\s+(ma|db|ri)\b.*", re.I)
_TOUCHSTONE_PARTS = {"MA": ("magnitude", "phase"), "DB": ("magnitude", "phase"),
                     "RI": ("real", "imaginary")}


@dataclass(frozen=True)
class ResponseColumn:
    """A column of a response."""

    label: str

    unit: str
    """Unit in the form of `plain`; empty if it is not given."""


def is_response_table(path: Path) -> bool:
    """Return whether a text file has a frequency, a magnitude or real part, and no time."""
    table = text_columns(path)
    if table is None:
        return False
    found = _columns(path, table)
    return "frequency" in found and bool({"magnitude", "real"} & set(found))


def read_response_table(path: Path) -> tuple[FloatArray, ComplexArray]:
    """Read a response from the text file of another program.

    The file has a frequency in Hz, kHz or rad/s, and the gain as real and imaginary part, or as
    magnitude (also in dB) and phase in degrees or rad. Or it is a Touchstone file, of which the
    first parameter is read. Magnitudes in nm/V and similar units are converted to um/V.

    Return the increasing frequencies in Hz, without 0, and the gains, (N,). A frequency occurs
    twice where two bands of a sweep meet; its gain is the mean of these rows. Raise ValueError if a
    column or its unit is missing, or a row has no number.
    """
    head = text_columns(path)
    found = {} if head is None else _columns(path, head)
    parts = ("real", "imaginary") if "real" in found else ("magnitude", "phase")
    for part in ("frequency", *parts):
        if part not in found:
            raise ValueError(
                f"{path}: no column is plainly the {part} (there are "
                f"{listing(list(head.columns) if head else [])}): name the columns, such as "
                "'frequency [Hz]', 'magnitude [dB]' and 'phase [deg]'")
    used = [found[part].label for part in ("frequency", *parts)]
    table = read_text_table(path, lambda _: used, no_progress)
    frequency_hz = table.columns[used[0]] * _factor(path, "frequency", found["frequency"], TO_HZ)
    first, second = (table.columns[label] for label in used[1:])
    if parts[0] == "real":
        gain = np.asarray(first + 1j * second)
    else:
        magnitude = 10.0 ** (first / 20.0) if found["magnitude"].unit == "db" else first
        gain = np.asarray(
            magnitude * np.exp(1j * second * _factor(path, "phase", found["phase"], TO_RAD)))
    gain = gain * UNITS["displacement"].get(found[parts[0]].unit.removesuffix("/v"), 1.0)
    return _sorted(path, table, frequency_hz, gain)


def _sorted(path: Path, table: Table, frequency_hz: FloatArray,
            gain: ComplexArray) -> tuple[FloatArray, ComplexArray]:
    wrong = np.flatnonzero(~np.isfinite(frequency_hz) | ~np.isfinite(gain) | (frequency_hz < 0.0))
    if wrong.size:
        raise ValueError(f"{table.place(int(wrong[0]))}: no finite gain at a positive frequency: "
                         "remove the row")
    used = frequency_hz > 0.0
    if not used.any():
        raise ValueError(f"{path} has no row with a positive frequency: measure again")
    once_hz, line, rows = np.unique(frequency_hz[used], return_inverse=True, return_counts=True)
    total = np.zeros(once_hz.size, dtype=complex)
    np.add.at(total, line, gain[used])
    return once_hz, np.asarray(total / rows)


def _columns(path: Path, table: Table) -> dict[str, ResponseColumn]:
    """Return the columns of a response by their part."""
    labels = list(table.columns)
    touchstone = _touchstone(path)
    if touchstone and len(labels) >= 3:
        unit, form = touchstone
        units = (unit, "db" if form == "DB" else "", "deg")
        return {part: ResponseColumn(label, unit) for part, label, unit in zip(
            ("frequency", *_TOUCHSTONE_PARTS[form]), labels, units, strict=False)}
    found: dict[str, ResponseColumn] = {}
    for label in labels:
        ratio = _PER.fullmatch(label)
        name, unit = (ratio[1], f"{ratio[2]}/{ratio[3]}") if ratio else name_and_unit(label)
        unit = plain(table.units.get(label) or unit)
        words = set(re.findall(r"[^\W\d_]+", name.lower()))
        if words & {"t", "time", "zeit"} or signal_of_unit(unit) == "time":
            return {}  # samples, of a sweep for instance
        part = next((part for part, known in WORDS.items() if (words | {unit}) & known), None)
        if part and part not in found:
            found[part] = ResponseColumn(label, unit or _unit_in(words))
    return found


def _unit_in(words: set[str]) -> str:
    """Return the unit that is a word of a label, such as mag_db; empty if there is none."""
    return next(iter(words & {"db", "deg", "hz", "khz", "rad"}), "")


def _touchstone(path: Path) -> tuple[str, str] | None:
    """Return the unit of frequency and the number format stated in a Touchstone file."""
    with open(path, encoding="utf-8", errors="replace") as file:
        for line, _ in zip(file, range(200), strict=False):
            option = _TOUCHSTONE.fullmatch(line.strip())
            if option:
                return option[1].lower(), option[2].upper()
    return None


def _factor(path: Path, part: str, column: ResponseColumn, factors: Mapping[str, float]) -> float:
    if column.unit not in factors:
        raise ValueError(
            f"{path}: the {part} '{column.label}' has no unit that is known: write one behind the "
            f"label, as in {part} [{next(iter(factors)).replace('hz', 'Hz')}]")
    return factors[column.unit]
