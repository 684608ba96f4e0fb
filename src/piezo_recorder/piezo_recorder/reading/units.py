# SPDX-License-Identifier: BSD-3-Clause
"""Units of time, voltage and displacement, and labels of columns with units."""

import re

from piezo_recorder.reading.recording import RecordingError

SIGNALS = ("time", "voltage", "displacement")

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "sek": 1.0, "sekunden": 1.0,
             "ms": 1e-3, "msec": 1e-3, "millisecond": 1e-3, "milliseconds": 1e-3,
             "us": 1e-6, "usec": 1e-6, "microsecond": 1e-6, "microseconds": 1e-6, "ns": 1e-9,
             "min": 60.0, "minutes": 60.0, "h": 3600.0, "hours": 3600.0,
             "d": 86400.0, "day": 86400.0, "days": 86400.0},
    "voltage": {"v": 1.0, "volt": 1.0, "volts": 1.0,
                "mv": 1e-3, "millivolt": 1e-3, "millivolts": 1e-3, "uv": 1e-6, "kv": 1e3},
    "displacement": {"um": 1.0, "micron": 1.0, "microns": 1.0, "micrometer": 1.0,
                     "micrometers": 1.0, "micrometre": 1.0, "micrometres": 1.0,
                     "mikrometer": 1.0, "nm": 1e-3, "nanometer": 1e-3, "nanometers": 1e-3,
                     "nanometre": 1e-3, "nanometres": 1e-3, "pm": 1e-6, "mm": 1e3,
                     "millimeter": 1e3, "millimetre": 1e3, "m": 1e6, "angstrom": 1e-4},
}
"""Value of one unit in s, V and um; all names in lower case."""

SHOWN = {"time": "s, ms, us, ns, min, h or d", "voltage": "V, mV, uV or kV",
         "displacement": "um, nm, pm, mm or m"}
SUFFIXES = {"s", "ms", "us", "ns", "v", "mv", "kv", "um", "nm", "pm", "mm", "m"}
"""Units that may end a name after an underscore or a space: ``v_min`` is not a time."""

OTHER_UNITS = {"hz", "khz", "rad", "deg", "°", "db", "ma", "°c", "degc", "%", "counts", "mn"}

_BRACKETED = re.compile(r"(.*?)[\s,_]*[\[(]\s*([^\])]*?)\s*[\])]\s*", re.S)
_SLASHED = re.compile(r"(.*\S)\s*/\s*(\S+)\s*")
_SUFFIXED = re.compile(r"(.*\S)(?:_|\s+in\s+|\s+)(\S+?)\s*")
_FACTORED = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)?\s*\*?\s*(\S*?)(/V)?\s*")


def plain(unit: str) -> str:
    """Return a unit as in the tables of this module: in lower case, both micro signs as u."""
    text = unit.strip().replace("µ", "u").replace("μ", "u").replace("Å", "angstrom")
    return text.strip("[]() .").lower()


def signal_of_unit(unit: str) -> str | None:
    """Return the signal that is measured in a unit, or None."""
    return next((signal for signal in SIGNALS if plain(unit) in UNITS[signal]), None)


def is_unit(text: str) -> bool:
    """Return whether a text is a unit, of a signal or of another quantity."""
    above, _, below = plain(text).partition("/")
    known = bool(signal_of_unit(above)) or above in OTHER_UNITS
    return known and (not below or bool(signal_of_unit(below)))


def name_and_unit(label: str) -> tuple[str, str]:
    """Split the label of a column, such as ``Time [s]``, ``t/ms``, ``U (V)`` or ``pos_nm``.

    The unit is empty if the label has no known one.
    """
    found = _BRACKETED.fullmatch(label)
    if found:
        return found[1].strip(), found[2]
    found = _SLASHED.fullmatch(label)
    if found and signal_of_unit(found[2]):
        return found[1].strip(), found[2]
    found = _SUFFIXED.fullmatch(label)
    if found and plain(found[2]) in SUFFIXES:
        return found[1].strip(), found[2]
    # Other single letters than V are more likely a quantity: "s" may be a displacement.
    is_unit_alone = signal_of_unit(label) and (len(plain(label)) > 1 or label.strip() == "V")
    return label.strip(), label.strip() if is_unit_alone else ""


def factor_and_unit(text: str) -> tuple[float, str]:
    """Split the text in brackets: ``nm``, ``20V``, or ``2.5um/V`` for a sensor in volts.

    The factor is 1 if there is none.
    """
    found = _FACTORED.fullmatch(text)
    if not found:
        return 1.0, text.strip()
    return float(found[1]) if found[1] else 1.0, found[2]


def scale_of(signal: str, unit: str) -> float:
    """Return the value of one unit in s, V or um; RecordingError if the signal has no such unit."""
    scale = UNITS[signal].get(plain(unit))
    if scale is None:
        raise RecordingError(
            f"'{unit}' is no unit of the {signal}: give {SHOWN[signal]}, such as "
            f"{signal}=NAME[{SHOWN[signal].split(',')[0]}]")
    return scale
