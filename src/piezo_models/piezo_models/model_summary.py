# SPDX-License-Identifier: BSD-3-Clause
"""The parameters of a model as a table, with standard deviations, in rad/s and in Hz."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from piezo_common.summary_table import Cell, SummaryTable

if TYPE_CHECKING:
    from piezo_models.cascade import StageModel
    from piezo_models.identified_model import IdentifiedModel

HEADS = ("parameter", "value", "std. dev.", "unit", "in Hz", "std. dev. (Hz)")
RAD_PER_S = "rad/s"

PARAMETERS = (
    ("creep", "poles_rad_per_s", "creep pole", RAD_PER_S, 1.0),
    ("creep", "zeros_rad_per_s", "creep zero", RAD_PER_S, 1.0),
    ("dynamics", "time_constant_s", "electric time constant", "ms", 1e3),
    ("dynamics", "mode_frequencies_rad_per_s", "mode frequency", RAD_PER_S, 1.0),
    ("dynamics", "damping_ratios", "damping ratio", "1", 1.0),
    ("dynamics", "antiresonance_frequencies_rad_per_s", "antiresonance frequency", RAD_PER_S, 1.0),
    ("dynamics", "antiresonance_damping_ratios", "antiresonance damping ratio", "1", 1.0),
)
"""Component, name in the model, name and unit in the table, and scale factor to that unit."""

CREEP_ROWS = tuple(text for component, _, text, _, _ in PARAMETERS if component == "creep")


def visited_fraction(visited: NDArray[np.bool_]) -> float:
    """Return the fraction of the area of the Preisach plane that recordings have visited.

    The mask, (L, L), is lower triangular; a cell on the diagonal counts half.
    """
    area = np.tril(np.ones(visited.shape)) - 0.5 * np.eye(len(visited))
    return float(area[visited].sum() / area.sum())


def model_rows(model: "StageModel", uncertainties: Mapping[str, Any]) -> list[tuple[Cell, ...]]:
    """Return table rows for the ranges and the parameters of a model; see `parameter_rows`."""
    hysteresis = model.hysteresis
    return [
        _row("voltage range, from", hysteresis.voltage_min_v, None, "V"),
        _row("voltage range, to", hysteresis.voltage_max_v, None, "V"),
        _row("hysteresis range", hysteresis.travel_um, None, "um"),
        *parameter_rows(model, uncertainties),
    ]


def parameter_rows(model: "StageModel", uncertainties: Mapping[str, Any]) -> list[tuple[Cell, ...]]:
    """Return table rows of `HEADS` for the parameters, in the order of the signal path.

    The uncertainties are those of `piezo_models.identified_model.IdentifiedModel`.
    """
    rows: list[tuple[Cell, ...]] = []
    for component, name, text, unit, scale in PARAMETERS:
        values = np.atleast_1d(getattr(getattr(model, component), name))
        deviations = _deviations(uncertainties.get(component), name, values.size)
        rows += _numbered(text, values, deviations, unit, scale)
    hysteretic = model.hysteretic_creep
    if hysteretic is not None:
        rows += _numbered("hysteretic creep, time constant",
                          np.asarray(hysteretic.time_constants_s), [None] * 99, "s")
    if model.first_rise is not None:
        rows.append(_row("first rise, remanence", model.first_rise.whole_um, None, "um"))
    of_effects = uncertainties.get("effects") or [{}] * len(model.effects)
    for effect, known in zip(model.effects, of_effects, strict=True):
        units = effect.units()
        for name, value in effect.parameters().items():
            values = np.atleast_1d(value)
            rows += _numbered(f"{effect.name}, {name}", values,
                              _deviations(known, name, values.size), units[name])
    return rows


def summary_of_model(model: "StageModel") -> SummaryTable:
    """Return the table of a model without standard deviations."""
    return SummaryTable("Model of a stage", HEADS, model_rows(model, {}))


def main_results(identified: "IdentifiedModel") -> SummaryTable:
    """Return a short table of an identified model.

    Of the creep it has only the fastest and the slowest pair, and nothing of parts without effect,
    whose parameter is 0.
    """
    model = identified.model
    visited = ""
    if not model.has_hysteresis:
        visited = ", without hysteresis"
    elif model.hysteresis.is_line:
        is_curve = np.ptp(model.hysteresis.reversible_um_per_v) > 0.0
        visited = f", with a hysteresis in front of a {'curve' if is_curve else 'line'}"
    elif identified.visited is not None:
        visited = (f", {100.0 * visited_fraction(identified.visited):.3g} % of the Preisach plane "
                   "visited")
    rows = [row for row in parameter_rows(model, identified.uncertainties)
            if row[1] and not str(row[0]).startswith(CREEP_ROWS)]
    return SummaryTable(
        f"identified: {model.hysteresis.travel_um:.5g} um from "
        f"{model.hysteresis.voltage_min_v:g} to {model.hysteresis.voltage_max_v:g} V{visited}",
        HEADS, [*_creep_times(identified), *rows])


def _creep_times(identified: "IdentifiedModel") -> Iterator[tuple[Cell, ...]]:
    """Yield rows for the number of creep pairs, and their extreme time constants."""
    poles = np.asarray(identified.model.creep.poles_rad_per_s)
    if not poles.size:
        return
    deviations = _deviations(identified.uncertainties.get("creep"), "poles_rad_per_s", poles.size)
    yield _row("creep, pairs of a pole and a zero", poles.size, None, "1")
    extremes = {"": 0} if poles.size == 1 else {
        "fastest ": np.argmax(poles), "slowest ": np.argmin(poles)}
    for name, index in extremes.items():
        deviation = deviations[index]
        yield _row(f"creep, {name}time constant", 1.0 / poles[index],
                   None if deviation is None else deviation / poles[index] ** 2, "s")


def summary_of_identified(identified: "IdentifiedModel") -> SummaryTable:
    """Return the table of an identified model: parameters, coverage, errors, adequacy."""
    rows = model_rows(identified.model, identified.uncertainties)
    if identified.visited is not None:
        rows.insert(3, _row("Preisach plane visited",
                            100.0 * visited_fraction(identified.visited), None, "%"))
    rows += [_row(f"error {name}", value, None, "") for name, value in _flat(identified.errors)]
    notes = [f"{component}: {part['verdict']}; its residual is {part['ratio']:.3g} times the "
             f"noise of its recording." for component, part in identified.adequacy.items()]
    return SummaryTable(f"Model identified {identified.created}", HEADS, rows, tuple(notes))


def shortfall(adequacy: Mapping[str, Mapping[str, Any]], errors: Mapping[str, Any],
              unfinished: str) -> str:
    """Return what is unfinished or inadequate and the resulting error; empty if nothing is.

    It is one line without a full stop. The arguments are fields of an `IdentifiedModel` or its
    file.
    """
    parts = []
    for component, part in adequacy.items():
        if part["verdict"] != "inadequate":
            continue
        percent = part.get("error_percent")
        of_motion = "" if percent is None else f", {percent:.3g} % of the motion"
        parts.append(
            f"the residual of {component} is {part['ratio']:.3g} times the noise{of_motion}")
    sentences = [f"the model is unfinished: {unfinished}"] if unfinished else []
    if parts:
        unseen = errors.get("e_y_percent")
        cost = "" if unseen is None else (
            f"; on data that was not fitted it is wrong by {unseen:.3g} %")
        sentences.append(f"the model is inadequate: {', '.join(parts)}{cost}")
    return "; ".join(sentences)


def text_of_model(model: "StageModel") -> str:
    """Return a one-line description of a model."""
    hysteresis = model.hysteresis
    modes = [f"{value / (2.0 * np.pi):.4g}" for value in model.dynamics.mode_frequencies_rad_per_s]
    parts = [
        f"{hysteresis.voltage_min_v:g} to {hysteresis.voltage_max_v:g} V",
        f"{hysteresis.travel_um:.4g} um",
        f"{len(model.creep.poles_rad_per_s)} creep poles",
        f"modes at {', '.join(modes)} Hz" if modes else "no modes",
        *(effect.name for effect in model.effects)]
    return f"<StageModel: {', '.join(parts)}>"


def _flat(errors: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, float]]:
    for name, value in errors.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", float(value)


def _numbered(text: str, values: NDArray[np.float64], deviations: Sequence[float | None],
              unit: str, scale: float = 1.0) -> Iterator[tuple[Cell, ...]]:
    """Yield a row for each value; several values are numbered from 1."""
    for number, (value, deviation) in enumerate(zip(values, deviations, strict=False), 1):
        name = f"{text} {number}" if values.size > 1 else text
        yield _row(name, scale * float(value), None if deviation is None else scale * deviation,
                   unit)


def _row(name: str, value: float, deviation: float | None, unit: str) -> tuple[Cell, ...]:
    if unit != RAD_PER_S:
        return name, value, deviation, unit, None, None
    turn = 2.0 * np.pi
    return name, value, deviation, unit, value / turn, None if deviation is None else (
        deviation / turn)


def _deviations(known: Mapping[str, Any] | None, name: str, size: int) -> list[float | None]:
    found = (known or {}).get(name)
    if found is None:
        return [None] * size
    return [float(value) if value is not None and np.isfinite(value) else None
            for value in np.atleast_1d(np.asarray(found, dtype=object))]
