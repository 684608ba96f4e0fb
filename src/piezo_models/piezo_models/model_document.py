# SPDX-License-Identifier: BSD-3-Clause
"""The schema of a model file, and the document of a model as it is written."""

import json
import math
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from piezo_common.schema import (
    Document,
    NotNegative,
    Number,
    NumberOrNumbers,
    Numbers,
    NumberTree,
    Part,
    Positive,
    entry,
    violation,
)
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics

if TYPE_CHECKING:
    from piezo_models.identified_model import IdentifiedModel

FORMAT = "piezo_stage_model"
VERSION = 1


class ModelFileError(ValueError):
    """A model file cannot be read or written; the message gives path, field and remedy."""


class CreepPart(Part):
    """Creep, a chain of first-order sections (3.20)."""

    poles_rad_per_s: list[Positive] = entry("Poles.", unit="rad/s")
    zeros_rad_per_s: list[Positive] = entry("Zeros, one for each pole.", unit="rad/s")


class DynamicsPart(Part):
    """Electric lag and modes of vibration (3.24)."""

    time_constant_s: NotNegative = entry(
        "Time constant of the amplifier's lag; 0 for none.", unit="s")
    mode_frequencies_rad_per_s: list[Positive] = entry(
        "Natural frequencies of the modes.", unit="rad/s")
    damping_ratios: list[Positive] = entry("Damping ratio of each mode.", unit="1")
    antiresonance_frequencies_rad_per_s: list[Positive] = entry(
        "Frequencies of the antiresonances, no more than modes.", unit="rad/s")
    antiresonance_damping_ratios: list[Positive] = entry("Damping ratio of each of them.", unit="1")


class HystereticCreepPart(Part):
    """Creep by play operators, in parallel with the hysteresis (thesis 6.2)."""

    half_widths_v: list[NotNegative] = entry("Half the width of each play.", unit="V")
    time_constants_s: list[Positive] = entry("Time constant of each.", unit="s")
    weights_um_per_v: Numbers = entry("Weight of each.", unit="um/V")


class FirstRisePart(Part):
    """First-cycle remanence of a stage that was never cycled."""

    voltages_v: Numbers = entry("Increasing voltages.", unit="V", shortest=2)
    remanence_um: list[NotNegative] = entry(
        "Displacement that remains after a first rise to each of them, from 0 on.", unit="um",
        shortest=2)


class HysteresisPart(Part):
    """Preisach hysteresis on a triangle of cells (3.6)."""

    voltage_min_v: Number = entry("Lower end of the range of the density.", unit="V")
    voltage_max_v: Number = entry("Upper end, above the lower one.", unit="V")
    offset_um: Number = entry("Displacement at negative saturation.", unit="um")
    reversible_um_per_v: list[NotNegative] | None = entry(
        "Reversible part, one number for a cell of the diagonal.", unit="um/V",
        default=None)
    density_um_per_v2: list[list[NotNegative]] = entry(
        "Density, row i with its i + 1 cells.", unit="um/V^2", shortest=1)

    @model_validator(mode="after")
    def _check_triangle(self) -> "HysteresisPart":
        for i, row in enumerate(self.density_um_per_v2):
            name = f"density_um_per_v2[{i}]"
            if len(row) != i + 1:
                raise violation(f"is not a list of {i + 1} numbers (found {len(row)})",
                                f"give {i + 1} numbers", name)
        reversible, cells = self.reversible_um_per_v, len(self.density_um_per_v2)
        if reversible is not None and len(reversible) != cells:
            raise violation(f"is not a list of {cells} numbers (found {len(reversible)})",
                            f"give {cells} numbers", "reversible_um_per_v")
        return self


class EffectPart(Part):
    """An effect that extends the cascade."""

    name: str = entry("Name of an effect that is installed.")
    parameters: dict[str, NumberOrNumbers] = entry(
        "Its parameters, units in the names; see `piezo_models.effects`.")


Deviation = NotNegative | None
"""A standard deviation; null if the data do not determine the parameter."""

Deviations = list[Deviation]
"""One standard deviation for each number of a parameter."""


class CreepDeviations(Part):
    """Standard deviations of the creep's parameters."""

    poles_rad_per_s: Deviations = entry("Of each pole.", unit="rad/s")
    zeros_rad_per_s: Deviations = entry("Of each zero.", unit="rad/s")


class DynamicsDeviations(Part):
    """Standard deviations of the parameters of the dynamics."""

    time_constant_s: Deviation = entry("Of the time constant.", unit="s")
    mode_frequencies_rad_per_s: Deviations = entry("Of each mode's frequency.", unit="rad/s")
    damping_ratios: Deviations = entry("Of each mode's damping ratio.", unit="1")
    antiresonance_frequencies_rad_per_s: Deviations = entry(
        "Of each antiresonance's frequency.", unit="rad/s")
    antiresonance_damping_ratios: Deviations = entry("Of their damping ratios.", unit="1")


class UncertaintiesPart(Part):
    """Standard deviations in the shape of the parameters; null if the data do not determine one."""

    creep: CreepDeviations | None = entry("Of the creep.", default=None)
    dynamics: DynamicsDeviations | None = entry("Of the dynamics.", default=None)
    effects: list[dict[str, Deviation]] | None = entry(
        "Of the parameters of each effect, in the order of `effects`.", default=None)


class RowsPart(Part):
    """The instant at which the rows of a recording are read, and the remaining delay."""

    read_at_samples: Number = entry(
        "Instant at which a row's displacement is read, after its voltage: the logger's habit.",
        unit="sample periods")
    is_straight: bool = entry(
        "Whether the voltage is straight between the rows, as a generator plays it, not held.",
        default=False)
    delay_s: Number | None = entry(
        "Remaining delay of the rows; left out where they do not determine it.", unit="s",
        default=None)
    standard_deviation_s: Deviation = entry("Of this delay.", unit="s")


class AdequacyPart(Part):
    """How well a component fits the recording that it was estimated from."""

    residual_rms_um: NotNegative = entry(
        "Residual, of the mean period where the voltage repeats itself.", unit="um")
    noise_rms_um: NotNegative = entry("The noise in the same samples.", unit="um")
    ratio: NotNegative = entry("The first over the second.", unit="1")
    verdict: Literal["adequate", "inadequate"] = entry(
        '"adequate" if the residual is noise, or too small to matter; else "inadequate".')
    error_percent: NotNegative | None = entry(
        "Relative error e_y (4.20) on the data that were fitted.", unit="%", default=None)
    noise_from: str | None = entry("Where the noise is estimated from.", default=None)
    left: str | None = entry(
        "If inadequate: the residual beyond the noise, at which frequencies, when, at which "
        "voltages.", default=None)
    advice: str | None = entry("If inadequate: what to do.", default=None)


class RecordingPart(Part):
    """A recording that the model was identified from."""

    path: str = entry("Where it was.")
    sha256: str = entry("Hash of its content.")


class ModelDocument(Document):
    """The model file: an identified model of a stage, readable by eye."""

    TITLE: ClassVar[str] = "model file"
    FORMAT: ClassVar[str] = FORMAT
    VERSION: ClassVar[int] = VERSION
    RENEW: ClassVar[str] = "identify the model again with this release, or save it again"

    format: str = entry(f"Always {FORMAT}.")
    version: Number = entry(f"Always {VERSION}.")
    created: str = entry("Time of creation, ISO 8601.")
    voltage_range_v: Numbers = entry(
        "Lowest and highest voltage of the identification.", unit="V", shortest=2, longest=2)
    sample_periods_s: dict[str, Positive] = entry(
        "Sample period of each experiment.", unit="s")
    errors: NumberTree = entry("Errors on data that was not fitted, units in the names.")
    recordings: list[RecordingPart] = entry("Where the model came from.")
    creep: CreepPart = entry("Creep.")
    dynamics: DynamicsPart = entry("Electric and vibration dynamics.")
    effects: list[EffectPart] = entry("Effects that extend the cascade.", default=[])
    uncertainties: UncertaintiesPart = entry(
        "Standard deviations of parameters.", default=UncertaintiesPart())
    rows: dict[str, RowsPart] = entry(
        "When the rows of each recording are read, by the name of the experiment.", default={})
    hysteretic_creep: HystereticCreepPart | None = entry(
        "Creep that depends on the branch of the hysteresis.", default=None)
    first_rise: FirstRisePart | None = entry(
        "Displacement missing until a stage has risen to its highest voltage once.", default=None)
    adequacy: dict[str, AdequacyPart] = entry(
        "By component (creep, dynamics, hysteresis; creep 2 of a second recording): its "
        "residual.",
        default={})
    visited: list[str] | None = entry(
        "Row i of the density: 1 for each of its i + 1 cells that the recordings determine, "
        "else 0.", default=None)
    unfinished: str = entry(
        "Why the identification ended early, and what it has not tried; empty where it was done.",
        default="")
    hysteresis: HysteresisPart = entry("Hysteresis.")

    @model_validator(mode="after")
    def _check_together(self) -> "ModelDocument":
        low_v, high_v = self.voltage_range_v
        if not low_v < high_v:
            raise violation("does not increase", "give [lowest, highest]", "voltage_range_v")
        rows = self.visited
        if rows is not None and not (
                len(rows) == len(self.hysteresis.density_um_per_v2)
                and all(len(row) == i + 1 and set(row) <= {"0", "1"}
                        for i, row in enumerate(rows))):
            raise violation(
                "is no triangle of 0 and 1 like the density", "give row i with a 1 for each of "
                "its i + 1 cells that was visited, or leave the field out", "visited")
        self._check_deviations()
        return self

    def _check_deviations(self) -> None:
        for part in ("creep", "dynamics"):
            for name, deviation in getattr(self.uncertainties, part) or ():
                parameter, path = getattr(getattr(self, part), name), f"uncertainties.{part}.{name}"
                if isinstance(parameter, list) and len(deviation) != len(parameter):
                    raise violation(f"is not a list of {len(parameter)} numbers",
                                    f"give {len(parameter)} numbers", path)
        deviations = self.uncertainties.effects
        if deviations is not None and len(deviations) != len(self.effects):
            raise violation(
                f"is not a list of {len(self.effects)} objects (found {len(deviations)})",
                "give one for each effect, or leave the field out", "uncertainties.effects")


def document_of(identified: "IdentifiedModel") -> dict[str, Any]:
    """Return the document of an `IdentifiedModel`: objects, lists, text and plain numbers."""
    model = identified.model
    dynamics = model.dynamics
    effects = [
        {"name": effect.name, "parameters": _plain(effect.parameters())}
        for effect in model.effects
    ]
    uncertainties = (
        {"uncertainties": _unknown_as_null(_plain(identified.uncertainties))}
        if identified.uncertainties else {}
    )
    visited = {} if identified.visited is None else {"visited": [
        "".join("01"[int(cell)] for cell in row[: i + 1])
        for i, row in enumerate(identified.visited)
    ]}
    hysteretic = model.hysteretic_creep
    hysteretic_creep = {} if hysteretic is None else {
        "hysteretic_creep": {
            "half_widths_v": list(hysteretic.half_widths_v),
            "time_constants_s": list(hysteretic.time_constants_s),
            "weights_um_per_v": list(hysteretic.weights_um_per_v),
        }
    }
    first_rise = {} if model.first_rise is None else {"first_rise": {
        "voltages_v": list(model.first_rise.voltages_v),
        "remanence_um": list(model.first_rise.remanence_um),
    }}
    return {
        "format": FORMAT,
        "version": VERSION,
        "created": identified.created,
        "voltage_range_v": [float(voltage) for voltage in identified.voltage_range_v],
        "sample_periods_s": _plain(identified.sample_periods_s),
        "errors": _plain(identified.errors),
        "recordings": list(identified.recordings),
        "creep": document_of_creep(model.creep),
        "dynamics": {
            "time_constant_s": dynamics.time_constant_s,
            "mode_frequencies_rad_per_s": list(dynamics.mode_frequencies_rad_per_s),
            "damping_ratios": list(dynamics.damping_ratios),
            "antiresonance_frequencies_rad_per_s": list(
                dynamics.antiresonance_frequencies_rad_per_s
            ),
            "antiresonance_damping_ratios": list(dynamics.antiresonance_damping_ratios),
        },
        **({"effects": effects} if effects else {}),
        **uncertainties,
        **({"rows": _unknown_as_null(_plain(identified.rows))} if identified.rows else {}),
        **hysteretic_creep,
        **first_rise,
        **({"adequacy": _plain(identified.adequacy)} if identified.adequacy else {}),
        **visited,
        **({"unfinished": identified.unfinished} if identified.unfinished else {}),
        "hysteresis": document_of_hysteresis(model.hysteresis),
    }


def document_of_creep(creep: CreepDynamics) -> dict[str, Any]:
    """Return the part of a document that describes the creep."""
    return {"poles_rad_per_s": list(creep.poles_rad_per_s),
            "zeros_rad_per_s": list(creep.zeros_rad_per_s)}


def document_of_hysteresis(hysteresis: PreisachModel) -> dict[str, Any]:
    """Return the part of a document that describes the hysteresis."""
    reversible, density = hysteresis.reversible_um_per_v, hysteresis.density_um_per_v2
    return {
        "voltage_min_v": hysteresis.voltage_min_v,
        "voltage_max_v": hysteresis.voltage_max_v,
        "offset_um": hysteresis.offset_um,
        **({"reversible_um_per_v": reversible.tolist()} if reversible.any() else {}),
        "density_um_per_v2": [row[: i + 1].tolist() for i, row in enumerate(density)],
    }


def _plain(value: Any) -> Any:
    """Return NumPy numbers as plain ones and tuples as lists, in dicts of any depth."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value.item() if isinstance(value, np.generic) else value


def _unknown_as_null(value: Any) -> Any:
    """Return standard deviations with None for infinite ones, as JSON has no infinity."""
    if isinstance(value, dict):
        return {key: _unknown_as_null(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_unknown_as_null(entry) for entry in value]
    return None if value == math.inf else value


def rendered(value: Any, indent: str = "") -> str:
    """Return a document as JSON with one line per field and per row of a matrix."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        fields = [f"{inner}{json.dumps(key)}: {rendered(v, inner)}" for key, v in value.items()]
        return "{\n" + ",\n".join(fields) + "\n" + indent + "}"
    if isinstance(value, list) and any(isinstance(entry, (list, dict)) for entry in value):
        entries = [f"{inner}{rendered(entry, inner)}" for entry in value]
        return "[\n" + ",\n".join(entries) + "\n" + indent + "]"
    return json.dumps(value, allow_nan=False)
