# SPDX-License-Identifier: BSD-3-Clause
"""Columns of a table for time, voltage and displacement: as described, or by their labels."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from piezo_recorder.reading.columns import ColumnsDocument, SignalColumn
from piezo_recorder.reading.recording import RecordingError
from piezo_recorder.reading.tables.table import Table, listing
from piezo_recorder.reading.units import SIGNALS, is_unit, name_and_unit, scale_of, signal_of_unit

OWN_LABELS = {"time": "time_s", "voltage": "voltage_v", "displacement": "displacement_um"}
"""Labels in the suite's own CSV files."""

WORDS = {
    "time": {"time", "times", "timestamp", "timestamps", "datetime", "date", "elapsed", "zeit",
             "temps", "tiempo", "tempo", "seconds", "second", "clock",
             "xvalue"},
    "voltage": {"voltage", "voltages", "volt", "volts", "spannung", "tension", "vpiezo", "upiezo",
                "piezovoltage", "drive", "command", "amplifier", "input", "hv", "stellspannung",
                "vin", "uin", "excitation", "actuation"},
    "displacement": {"displacement", "position", "pos", "weg", "auslenkung", "verschiebung",
                     "deplacement", "déplacement", "distance", "deflection", "stroke", "output",
                     "elongation", "extension", "travel", "desplazamiento", "sensor"},
}
LETTERS = {"time": {"t"}, "voltage": {"u", "v"}, "displacement": {"x", "y", "z", "d"}}
RATES = {"fs": 1.0, "rate": 1.0, "samplerate": 1.0, "samplingrate": 1.0, "sampleratehz": 1.0,
         "samplingfrequency": 1.0, "fshz": 1.0}
PERIODS = {"dt": 1.0, "ts": 1.0, "sampleperiod": 1.0, "sampleperiods": 1.0, "sampletime": 1.0,
           "samplingtime": 1.0, "samplinginterval": 1.0}
"""Names of single numbers in a file that are the rate (Hz) or the period (s), with their units."""

OF_UNIT, OF_WORD, OF_LETTER = 4, 2, 1
"""Scores of a column for its unit, a word in its name, and a usual letter."""

EXAMPLE = "--columns time=NAME[s] voltage=NAME[V] displacement=NAME[um]"


@dataclass(frozen=True)
class SignalSource:
    """Column of a signal."""

    label: str

    scale: float
    """Value of one unit of the column in s, V or um."""
    note: str = ""
    """Assumption to report; empty if there is none."""


def needed_columns(table: Table, described: ColumnsDocument) -> dict[str, SignalSource]:
    """Choose the columns of ``time``, ``voltage`` and ``displacement``.

    There is none of the time if the rate is known. RecordingError is raised if a signal has no
    column, several candidates, or a column without a unit.
    """
    labels = list(table.columns)
    own_time = described.time is not None or OWN_LABELS["time"] in labels
    found: dict[str, SignalSource] = {}
    for signal in SIGNALS:
        wish: SignalColumn | None = getattr(described, signal)
        if wish is not None:
            label = described_label(table, signal, wish.column)
        elif OWN_LABELS[signal] in labels:
            label = OWN_LABELS[signal]
        else:
            taken = {each.label for each in found.values()} | {
                described_label(table, other, getattr(described, other).column)
                for other in SIGNALS if getattr(described, other) is not None}
            best = guessed_labels(table, signal, [name for name in labels if name not in taken])
            if signal == "time" and not own_time and not best and rate_hz_of(table, described):
                continue
            label = _only(table, signal, best)
        found[signal] = _source(table, signal, label, wish)
    _refuse_shared(table, found)
    return found


def described_label(table: Table, signal: str, name: str) -> str:
    """Return the label of the column that a user gave by label, name or number."""
    labels = list(table.columns)
    small = name.strip().lower()
    for matches in (
        [label for label in labels if label == name],
        [label for label in labels if label.strip().lower() == small],
        [label for label in labels if name_and_unit(label)[0].lower() == small],
        [label for label in labels if label.rpartition(".")[2].lower() == small],
        labels[int(small) - 1:int(small)] if small.isdecimal() and int(small) else [],
    ):
        if len(matches) == 1:
            return matches[0]
    raise RecordingError(f"{table.header_place}: no column '{name}' for the {signal} (there are "
                         f"{listing(labels)}): name one of them, or its number")


def guessed_labels(table: Table, signal: str, labels: Iterable[str]) -> list[str]:
    """Return the columns with the highest score by unit and name; empty if all scores are zero."""
    scores = {label: _score(table, signal, label) for label in labels}
    best = max(scores.values(), default=0)
    return [label for label, score in scores.items() if score == best] if best > 0 else []


def _score(table: Table, signal: str, label: str) -> int:
    name, unit = name_and_unit(label)[0], _unit(table, label)
    of = signal_of_unit(unit) if unit else None
    if unit and of != signal:
        return 0
    words = set(re.findall(r"[^\W\d_]+", name.lower()))
    compact = re.sub(r"[\W\d_]+", "", name.lower())
    score = OF_UNIT if of else 0
    if words & WORDS[signal] or compact in WORDS[signal]:
        return score + OF_WORD
    last = name.rpartition(".")[2].strip().lower()
    return score + OF_LETTER if last in LETTERS[signal] else score


def _unit(table: Table, label: str) -> str:
    """Return the unit of a column; among labels that are all units, ``s`` is seconds."""
    unit = table.units.get(label) or name_and_unit(label)[1]
    return unit or (label if all(map(is_unit, table.columns)) else "")


def _only(table: Table, signal: str, best: list[str]) -> str:
    if len(best) == 1:
        return best[0]
    own = OWN_LABELS[signal]
    labels = listing(list(table.columns))
    if best:
        raise RecordingError(
            f"{table.header_place}: {listing(best)} may each be the {signal}: say which, as in "
            f"--columns {signal}=NAME[{own.rpartition('_')[2].replace('v', 'V')}]")
    for label in guessed_labels(table, signal, table.left_out):
        raise RecordingError(
            f"{table.header_place}: '{label}' has {table.left_out[label]} values where other "
            f"columns have {table.rows}: save all of them with one length")
    raise RecordingError(
        f"{table.header_place}: the column {own} is missing, and none of {labels} is plainly the "
        f"{signal}: say which they are, as in {EXAMPLE}"
        + (", or give the rate, as in rate=10[kHz]" if signal == "time" else ""))


def _source(table: Table, signal: str, label: str, wish: SignalColumn | None) -> SignalSource:
    unit = (wish.unit if wish else "") or _unit(table, label)
    factor = wish.factor if wish else 1.0
    if unit and (wish and wish.unit or signal_of_unit(unit) == signal):
        return SignalSource(label, factor * scale_of(signal, unit))
    own_unit = {"time": "s", "voltage": "V"}.get(signal)
    if unit or own_unit is None:
        what = f"is in '{unit}'" if unit else "has no unit"
        raise RecordingError(
            f"{table.header_place}: the {signal} '{label}' {what}: say which unit it has, as in "
            f"--columns {signal}={label if len(label) < 20 else 'NAME'}"
            f"[{own_unit or 'um'}]")
    other = {"time": "ms", "voltage": "mV"}[signal]
    note = (f"{table.path}: '{label}' has no unit; it is taken for the {signal} in {own_unit}: if "
            f"it is in {other}, say so, as in --columns {signal}={label}[{other}]")
    return SignalSource(label, factor, note)


def _refuse_shared(table: Table, found: dict[str, SignalSource]) -> None:
    labels = [each.label for each in found.values()]
    for signal, each in found.items():
        if labels.count(each.label) > 1:
            raise RecordingError(f"{table.header_place}: the column '{each.label}' cannot be the "
                                 f"{signal} and another signal: say which is which, as in "
                                 f"{EXAMPLE}")


def rate_hz_of(table: Table, described: ColumnsDocument) -> float | None:
    """Return the rate of the rows given by the user, or by a single number in the file."""
    if described.sample_rate_hz is not None:
        return described.sample_rate_hz
    for name, value in table.scalars.items():
        last = re.sub(r"[\W_]+", "", name.rpartition(".")[2].lower())
        if last in RATES and value > 0.0:
            return value
        if last in PERIODS and value > 0.0:
            return 1.0 / value
    return None
