# SPDX-License-Identifier: BSD-3-Clause
"""Build a model from the document of a model file."""

import math
from collections.abc import Callable
from dataclasses import MISSING, fields
from os import PathLike
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from piezo_common.schema import SchemaError, checked
from piezo_common.schema.checking import quoted
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect, known_effects
from piezo_models.hysteresis.first_rise import FirstRise
from piezo_models.hysteresis.hysteretic_creep import HystereticCreep
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_models.model_document import (
    Deviation,
    Deviations,
    HysteresisPart,
    ModelDocument,
    ModelFileError,
    UncertaintiesPart,
)

T = TypeVar("T")


def identified_model_of(document: object, path: str | PathLike[str]) -> IdentifiedModel:
    """Return the model that a document of `document_of` describes, checked field by field.

    Raises `ModelFileError`, which names the path, if the document is not of this version, or has a
    missing, unknown or invalid field.
    """
    try:
        return built_model(checked(ModelDocument, document))
    except SchemaError as error:
        raise ModelFileError(f"{path}: {error}") from None


def built_model(document: ModelDocument) -> IdentifiedModel:
    """Build the model of a document that fits its schema.

    Raises `SchemaError` if the parts contradict each other, or an effect is not installed.
    """
    hysteretic, first_rise = document.hysteretic_creep, document.first_rise
    low_v, high_v = document.voltage_range_v
    return IdentifiedModel(
        model=StageModel(
            _built("hysteresis", built_hysteresis, document.hysteresis),
            _built("creep", CreepDynamics, **dict(document.creep)),
            _built("dynamics", ElectricVibrationDynamics, **dict(document.dynamics)),
            None if hysteretic is None else _built(
                "hysteretic_creep", HystereticCreep, **dict(hysteretic)),
            _effects(document),
            None if first_rise is None else _built(
                "first_rise", FirstRise, tuple(first_rise.voltages_v),
                tuple(first_rise.remanence_um)),
        ),
        voltage_range_v=(low_v, high_v),
        sample_periods_s=document.sample_periods_s,
        errors=document.errors,
        recordings=[dict(recording) for recording in document.recordings],
        created=document.created,
        uncertainties=_deviations(document.uncertainties),
        rows={name: {field: math.inf if value is None else value for field, value in part
                     if value is not False and (field != "delay_s" or value is not None)}
              for name, part in document.rows.items()},
        visited=_visited(document.visited),
        adequacy={component: part.model_dump(exclude_none=True)
                  for component, part in document.adequacy.items()},
        unfinished=document.unfinished,
    )


def _deviations(part: UncertaintiesPart) -> dict[str, Any]:
    """Return standard deviations by part; those of the effects in a list."""
    deviations: dict[str, Any] = {
        name: {parameter: _infinite_where_untold(value) for parameter, value in of_part}
        for name, of_part in (("creep", part.creep), ("dynamics", part.dynamics)) if of_part}
    if part.effects is not None:
        deviations["effects"] = [
            {parameter: _infinite_where_untold(value) for parameter, value in effect.items()}
            for effect in part.effects]
    return deviations


def _infinite_where_untold(deviation: Deviation | Deviations) -> float | list[float]:
    if isinstance(deviation, list):
        return [math.inf if value is None else value for value in deviation]
    return math.inf if deviation is None else deviation


def built_hysteresis(part: HysteresisPart) -> PreisachModel:
    """Return the hysteresis that a part of a document describes."""
    rows = part.density_um_per_v2
    density = np.zeros((len(rows), len(rows)))
    for i, row in enumerate(rows):
        density[i, : i + 1] = row
    reversible = np.zeros(len(rows)) if part.reversible_um_per_v is None else np.array(
        part.reversible_um_per_v)
    return PreisachModel(part.voltage_min_v, part.voltage_max_v, density, part.offset_um,
                         reversible)


def _effects(document: ModelDocument) -> tuple[Effect, ...]:
    known, effects = known_effects(), []
    for i, part in enumerate(document.effects):
        path = f"effects[{i}]"
        if part.name not in known:
            raise SchemaError(
                f"{path}.name is no effect that is installed here (found {quoted(part.name)})",
                f"install it, or give one of {', '.join(known)}")
        kind = known[part.name]
        for each in fields(kind):
            # Files of earlier versions lack parameters that were added since, with a default.
            if each.default is MISSING and each.name not in part.parameters:
                raise SchemaError(f"{path}.parameters.{each.name} is missing", ModelDocument.RENEW)
        for name in part.parameters:
            if name not in kind.units():
                raise SchemaError(f"{path}.parameters.{name} is unknown to this version",
                                  "remove it")
        effects.append(_built(path, kind, **part.parameters))
    return tuple(effects)


def _visited(rows: list[str] | None) -> NDArray[np.bool_] | None:
    if rows is None:
        return None
    return np.array([[cell == "1" for cell in row.ljust(len(rows), "0")] for row in rows])


def _built(path: str, kind: Callable[..., T], *arguments: Any, **named: Any) -> T:
    """Return an object of a part; a validation error of its class is raised with its path."""
    try:
        return kind(*arguments, **named)
    except ValueError as error:
        problem, _, cure = str(error).rpartition("; ")
        raise SchemaError(f"{path}: {problem or error}", cure or ModelDocument.RENEW) from None
