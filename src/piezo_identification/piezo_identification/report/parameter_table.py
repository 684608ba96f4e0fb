# SPDX-License-Identifier: BSD-3-Clause
"""Tables of parameters: value, standard deviation, interval, and frequency in Hz."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from piezo_models.effects import known_effects
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_summary import parameter_rows

HEADS = ("parameter", "value", "standard deviation", "95 % interval", "in Hz")
QUANTILE = 1.96
"""Half width, in standard deviations, of the interval with 95 % of a normal distribution."""


def parameter_table(identified: IdentifiedModel) -> list[tuple[str, ...]]:
    """Return the parameters of creep, dynamics and effects with their uncertainties.

    `HEADS` are followed by a row for each number; there is none for a model of hysteresis alone.
    """
    rows: list[tuple[str, ...]] = [HEADS]
    for name, value, deviation, unit, *_ in parameter_rows(
            identified.model, identified.uncertainties):
        if value or name != "electric time constant":
            rows += number_rows(str(name), value, deviation, str(unit))
    return rows


def effect_rows(effects: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return the parameters of the effects of a verdict, and their error reductions."""
    rows: list[tuple[str, ...]] = [("effect", *HEADS, "error reduction (%)")]
    kinds = known_effects()
    for entry in effects:
        units = kinds[entry["name"]].units() if entry["name"] in kinds else {}
        name, reduction = entry["name"], f"{entry['error_reduction_percent']:.1f}"
        for field, value in entry["parameters"].items():
            deviation = entry.get("standard_deviations", {}).get(field)
            for row in number_rows(field, value, deviation, units.get(field, "1")):
                rows.append((name, *row, reduction))
                name = reduction = ""
    return rows


def number_rows(name: str, values: Any, deviations: Any,
                unit: str) -> Iterator[tuple[str, ...]]:
    """Yield a row of `HEADS` for each number of a parameter.

    The deviations are None if they are unknown; the unit is "1" if there is none.
    """
    listed = np.atleast_1d(np.asarray(values, dtype=float))
    known = (np.full(listed.shape, np.nan) if deviations is None
             else np.atleast_1d(np.asarray(deviations, dtype=float)))
    for number, (value, deviation) in enumerate(zip(listed, known, strict=True), 1):
        which = f" {number}" if listed.size > 1 else ""
        text, spread = rounded(value, deviation)
        low, high = (rounded(value + sign * QUANTILE * deviation, deviation)[0]
                     for sign in (-1.0, 1.0))
        hertz = "-"
        if unit == "rad/s":
            turn = 2.0 * np.pi
            hertz = " ± ".join(filter(None, rounded(value / turn, deviation / turn)))
        yield (f"{name}{which}" + ("" if unit == "1" else f" ({unit})"), text, spread or "-",
               f"{low} to {high}" if spread else "not known", hertz)


def rounded(value: float, deviation: float) -> tuple[str, str]:
    """Return a value and its standard deviation, both to two digits of the deviation.

    A deviation of 0, infinity or nan is unknown, and becomes empty.
    """
    if not np.isfinite(deviation) or deviation <= 0.0:
        return f"{value:.4g}", ""
    decimals = 1 - int(np.floor(np.log10(deviation)))
    if decimals <= 0:
        return f"{value:.0f}", f"{deviation:.0f}"
    if decimals <= 7:
        return f"{value:.{decimals}f}", f"{deviation:.{decimals}f}"
    digits = max(1, decimals + int(np.floor(np.log10(abs(value) or 1.0))))
    return f"{value:.{digits}e}", f"{deviation:.1e}"
