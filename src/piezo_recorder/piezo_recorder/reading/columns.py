# SPDX-License-Identifier: BSD-3-Clause
"""Description of the columns of a file by the user: by option, or in a YAML file next to it."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

from piezo_common.schema import Document, Number, Part, Positive, SchemaError, entry, load_document
from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.reading.units import SIGNALS, factor_and_unit

SUFFIX = ".columns.yaml"
FOLDER_FILE = "columns.yaml"
RATES = {"hz": 1.0, "khz": 1e3, "mhz": 1e6}

_OPTION = re.compile(r"\s*(\w+)\s*=\s*(.*?)\s*(?:\[([^\]]*)\])?\s*", re.S)


class SignalColumn(Part):
    """Column and unit of a signal in a file."""

    column: str = entry("Label of the column, with or without its unit, or its number from 1.")
    unit: str = entry("Unit of its numbers; that of the label by default.", default="")
    factor: Number = entry("By which its numbers are multiplied to be in that unit, such as the "
                           "gain of an amplifier.", default=1.0)


class RecordingColumn(Part):
    """Column that distinguishes the recordings of one file."""

    column: str = entry("Label of a column that numbers them; none where they are groups of the "
                        "file, or where the time begins again.", default="")
    only: str = entry("The one to read; all by default.", default="")


class ColumnsDocument(Document):
    """Meaning of the columns of a file; omitted entries are guessed."""

    TITLE: ClassVar[str] = "file of columns"
    SYNTAX: ClassVar[str] = "yaml"

    time: SignalColumn | None = entry("The time of each row.", default=None)
    voltage: SignalColumn | None = entry("The voltage at the actuator.", default=None)
    displacement: SignalColumn | None = entry("The measured displacement.", default=None)
    sample_rate_hz: Positive | None = entry(
        "Rows a second, for a file without a time.", unit="Hz", default=None)
    recording: RecordingColumn | None = entry(
        "How several recordings in the file are distinguished.", default=None)


GUESSED = ColumnsDocument()
"""No description: everything unambiguous is guessed."""


def parse_columns(options: Sequence[str] | None) -> ColumnsDocument:
    """Parse the values of the option ``--columns``.

    Parameters
    ----------
    options : sequence of str, optional
        Values such as ``time=t[ms]``, ``voltage=Vpiezo[V]``, ``displacement=pos[nm]``,
        ``rate=10[kHz]``, ``recording=run[2]``; or the path of one YAML file. A number before the
        unit is a factor.

    Raises
    ------
    RecordingError
        If a value does not have this form, or the file does not match its schema.

    Examples
    --------
    >>> parse_columns(["time=t[ms]", "voltage=monitor[20V]"]).voltage.factor
    20.0
    """
    if not options:
        return GUESSED
    if len(options) == 1 and "=" not in options[0] and options[0].endswith((".yaml", ".yml")):
        return load_columns(Path(options[0]))
    content: dict[str, Any] = {}
    for option in options:
        found = _OPTION.fullmatch(option)
        kind = found[1].lower() if found else ""
        if found is None or kind not in (*SIGNALS, "rate", "recording"):
            raise RecordingError(
                f"--columns has '{option}': give words such as time=t[ms] voltage=Vpiezo[V] "
                "displacement=pos[nm] rate=10[kHz] recording=run[2], or a YAML file")
        content |= _entry(kind, found[2], found[3])
    return ColumnsDocument.model_validate(content)


def _entry(kind: str, name: str, brackets: str | None) -> dict[str, Any]:
    if kind == "recording":
        return {kind: {"column": name, "only": brackets or ""}}
    if kind == "rate":
        try:
            rate_hz = float(name) * RATES[(brackets or "Hz").strip().lower()]
        except (ValueError, KeyError):
            rate_hz = 0.0
        if not 0.0 < rate_hz < 1e12:
            raise RecordingError(
                f"--columns has rate={name}[{brackets or ''}]: give a positive number in Hz, kHz "
                "or MHz, such as rate=10[kHz]")
        return {"sample_rate_hz": rate_hz}
    if not name:
        raise RecordingError(f"--columns names no column for the {kind}: give {kind}=NAME[UNIT]")
    factor, unit = factor_and_unit(brackets or "")
    return {kind: {"column": name, "unit": unit, "factor": factor}}


def load_columns(path: Path) -> ColumnsDocument:
    """Read a YAML file that describes the columns; raise RecordingError if it is invalid."""
    try:
        return load_document(ColumnsDocument, path)
    except SchemaError as error:
        raise RecordingError(f"{path}: {error}") from None


def columns_for(path: Path, described: ColumnsDocument = GUESSED) -> ColumnsDocument:
    """Complete the user's description of a file by the YAML file next to it.

    The user's entries take precedence. ``run.csv`` may have ``run.columns.yaml`` next to it, or all
    files of a folder may share ``columns.yaml``.
    """
    for neighbour in (path.with_name(path.stem + SUFFIX), path.with_name(FOLDER_FILE)):
        if neighbour.is_file() and neighbour != path:
            written = load_columns(neighbour)
            return written.model_copy(update={
                name: value for name, value in described if value is not None})
    return described
