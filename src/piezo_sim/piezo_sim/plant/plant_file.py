# SPDX-License-Identifier: BSD-3-Clause
"""Strict reading of a plant file: every parameter with value, unit and source."""

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar, get_type_hints

from pydantic import create_model, model_validator

from piezo_common.registered import registered
from piezo_common.regular_file import UnreadableFile
from piezo_common.schema import (
    Document,
    Number,
    Numbers,
    Part,
    SchemaError,
    check,
    entry,
    parsed,
    violation,
)
from piezo_common.schema.checking import quoted
from piezo_common.text_file import read_bounded_text
from piezo_sim.effects.ambient_temperature import ThermalDrift
from piezo_sim.effects.clamped_beam import ClampedBeam
from piezo_sim.effects.clock_jitter import SamplingJitter, UpdateJitter
from piezo_sim.effects.current_limit import CurrentLimit
from piezo_sim.effects.depolarisation import Depolarisation
from piezo_sim.effects.distributed_lag import DistributedLag
from piezo_sim.effects.distributed_line import DistributedLine
from piezo_sim.effects.generalised_plays import GeneralisedPlays
from piezo_sim.effects.guide_spring import GuideSpring
from piezo_sim.effects.hardening_spring import HardeningSpring
from piezo_sim.effects.intermittent_contact import IntermittentContact
from piezo_sim.effects.loaded_mode import LoadedMode
from piezo_sim.effects.logarithmic_creep import LogarithmicCreep
from piezo_sim.effects.mains_hum import MainsHum
from piezo_sim.effects.output_converter import OutputConverter
from piezo_sim.effects.parallel_mode import ParallelMode
from piezo_sim.effects.power_law_creep import PowerLawCreep
from piezo_sim.effects.self_heating import SelfHeating
from piezo_sim.effects.serial_stage import SerialStage
from piezo_sim.effects.slewing_amplifier import SlewingAmplifier
from piezo_sim.effects.soft_backlash import SoftBacklash
from piezo_sim.effects.soft_saturation import SoftSaturation
from piezo_sim.effects.spikes import Spikes
from piezo_sim.effects.switched_heat import SwitchedHeat
from piezo_sim.effects.switching_delay import SwitchingDelay
from piezo_sim.effects.transducer_curve import TransducerCurve
from piezo_sim.effects.transport_delay import TransportDelay
from piezo_sim.effects.xy_flexure import XYFlexure
from piezo_sim.faults.device_failure import DeviceFailure
from piezo_sim.faults.sensor_faults import NoisySensor, OffScaleSensor, SilentSensor, StuckSensor
from piezo_sim.plant.amplifier import VoltageAmplifier
from piezo_sim.plant.continuous_preisach import PreisachHysteresis
from piezo_sim.plant.linear_effects import Creep, ElectricLag, VibrationMode
from piezo_sim.plant.mechanism import Mechanics
from piezo_sim.plant.named_plants import AXES_PLANTS, PLANTS
from piezo_sim.plant.plant_effect import Effect, PlantConfigError
from piezo_sim.plant.sensor import DisplacementSensor

GROUP = "piezo_sim.effects"
"""Group of entry points through which other packages add effects of the plant."""

# To add an effect, write a module and add its class here.
EFFECTS = {
    effect.name: effect
    for effect in (
        VoltageAmplifier,
        PreisachHysteresis,
        Creep,
        ElectricLag,
        VibrationMode,
        DisplacementSensor,
        LogarithmicCreep,
        ThermalDrift,
        ParallelMode,
        TransportDelay,
        DistributedLag,
        TransducerCurve,
        MainsHum,
        CurrentLimit,
        SoftSaturation,
        SwitchingDelay,
        GuideSpring,
        HardeningSpring,
        SoftBacklash,
        Spikes,
        SelfHeating,
        IntermittentContact,
        Depolarisation,
        LoadedMode,
        SwitchedHeat,
    )
}

# Effects of the plant `beam`, in the order of the signal.
BEAM_EFFECTS = {
    effect.name: effect
    for effect in (
        OutputConverter,
        UpdateJitter,
        SlewingAmplifier,
        DistributedLine,
        GeneralisedPlays,
        PowerLawCreep,
        ClampedBeam,
        SamplingJitter,
    )
}

# Faults with their time windows; in the section sensor, behind the effects that they affect.
FAULTS = {
    fault.name: fault
    for fault in (StuckSensor, SilentSensor, OffScaleSensor, NoisySensor, DeviceFailure)
}

MECHANICS: dict[str, type[Mechanics]] = {kind.name: kind for kind in (XYFlexure, SerialStage)}
"""Effects that move several axes together."""


@dataclass(frozen=True)
class PlantConfig:
    """Effects of the plant, each section in the order of the signal."""

    amplifier: tuple[Effect, ...]
    """Effects from the commanded voltage to the applied voltage, V."""
    stage: tuple[Effect, ...]
    """Effects from the applied voltage, V, to the true displacement, um."""
    sensor: tuple[Effect, ...]
    """Effects from the true displacement to the measured displacement, um."""


@dataclass(frozen=True)
class AxesPlantConfig:
    """Effects of a plant of several axes."""

    axes: dict[str, PlantConfig]
    """Effects of each axis by name: `stage` ends at the free stroke of its actuator, `sensor`
    starts at the motion that its sensor sees."""
    mechanics: Mechanics
    """From the strokes of all axes to their positions, and to the motion that the sensors see."""


class PlantSections(Part):
    """Effects in the order of the signal."""

    amplifier: list[dict[str, Any]] = entry(
        "From the commanded voltage to the applied voltage (V); each entry names its `effect`, "
        "and gives each parameter with `value`, `unit` and `source`.", shortest=1)
    stage: list[dict[str, Any]] = entry(
        "From the applied voltage (V) to the true displacement (um); entries as above.",
        shortest=1)
    sensor: list[dict[str, Any]] = entry(
        "From the true to the measured displacement (um); entries as above.", shortest=1)


class PlantDocument(PlantSections, Document):
    """The plant file of one axis."""

    TITLE: ClassVar[str] = "plant file"
    SYNTAX: ClassVar[str] = "yaml"
    RENEW: ClassVar[str] = "add it"


class AxesPlantDocument(Document):
    """The plant file of several axes."""

    TITLE: ClassVar[str] = "plant file"
    SYNTAX: ClassVar[str] = "yaml"
    RENEW: ClassVar[str] = "add it"

    axes: dict[str, PlantSections] = entry(
        "Sections of each axis, by its short lower-case name. `stage` leads to the free stroke of "
        "its actuator (um), `sensor` from what it sees to what is measured.",
        shortest=2, longest=3)
    mechanics: dict[str, Any] = entry(
        "What all axes move together, as an entry of a section: `xy_flexure` or `serial_stage`.")


class Parameter(Part):
    """A parameter of an effect with its unit and its source."""

    UNIT: ClassVar[str] = ""

    value: Any = entry("A number, a whole number or a list of numbers, as the effect requires.")
    unit: str = entry("The unit that the effect states.")
    source: str = entry("Where the value comes from; not empty.")

    @model_validator(mode="after")
    def _check_unit_and_source(self) -> "Parameter":
        if self.unit != self.UNIT:
            raise violation(f"is {quoted(self.unit)}", f'state the value in "{self.UNIT}"', "unit")
        if not self.source.strip():
            raise violation("is empty", "give the source of the value", "source")
        return self


SCHEMAS: dict[Any, Any] = {int: int, float: Number}
"""Check of a parameter by its type; all other types are lists of numbers."""


@cache
def effect_schema(kind: type[Effect]) -> type[Part]:
    """Return the schema of an effect's entry in a plant file, from the effect's own fields."""
    # With postponed annotations, the fields contain only the names of the types.
    types = get_type_hints(kind)

    def parameter(field: dataclasses.Field) -> type[Part]:
        value = SCHEMAS.get(types[field.name], Numbers)
        typed = create_model("Value", __base__=Parameter, value=(value, ...))
        typed.UNIT = field.metadata["unit"]
        return typed

    fields: dict[str, Any] = {field.name: (parameter(field), ...)
                              for field in dataclasses.fields(kind)}
    return create_model(kind.__name__, __base__=Part, effect=(str, ...), **fields)


def read_plant(path: str | Path | None = None) -> PlantConfig:
    """Read a plant file of one axis; see `read_any_plant`.

    Parameters
    ----------
    path : path-like, optional
        YAML file, or one of the names `PLANTS`; by default the plant ``default``.
    """
    plant = read_any_plant(path)
    if isinstance(plant, AxesPlantConfig):
        raise PlantConfigError(f"{path}: the plant has the axes {', '.join(plant.axes)}; "
                               f"give one of one axis, such as {', '.join(PLANTS)}.")
    return plant


def read_any_plant(path: str | Path | None = None) -> PlantConfig | AxesPlantConfig:
    """Read a plant file of one axis or several.

    The path is that of a YAML file, or one of the names `PLANTS` and `AXES_PLANTS`; by default it
    is the plant ``default``. Raise PlantConfigError if the file cannot be read, or a section,
    effect or parameter is unknown, missing, without unit or source, not finite, or impossible.
    """
    name, named = "default" if path is None else str(path), PLANTS | AXES_PLANTS
    if name in named:
        return parse_plant((resources.files("piezo_sim") / named[name]).read_text("utf-8"))
    try:
        return parse_plant(read_bounded_text(name))
    except UnreadableFile as error:
        raise PlantConfigError(f"{path}: the plant file {error}; give a file or one of "
                               f"{', '.join(named)}.") from None
    except PlantConfigError as error:
        raise PlantConfigError(f"{path}: {error}") from None


def parse_plant(text: str) -> PlantConfig | AxesPlantConfig:
    """Parse the text of a plant file; see `read_any_plant`."""
    try:
        if re.search(r"^axes:", text, re.MULTILINE):
            return _of_axes(parsed(AxesPlantDocument, text))
        return _of_sections(parsed(PlantDocument, text), "")
    except SchemaError as error:
        raise PlantConfigError(f"{error}.") from None


def _of_sections(sections: PlantSections, where: str) -> PlantConfig:
    return PlantConfig(**{
        section: tuple(_effect(f"{where}{section}[{index}]", content, _known_effects())
                       for index, content in enumerate(contents))
        for section, contents in sections})


def _of_axes(document: AxesPlantDocument) -> AxesPlantConfig:
    for axis in document.axes:
        if not re.fullmatch("[a-z][a-z0-9]*", axis):
            raise SchemaError(f"axes has the name {quoted(axis)}",
                              "give short lower-case names such as x")
    mechanics: Any = _effect("mechanics", document.mechanics, MECHANICS)
    if mechanics.axes != len(document.axes):
        raise SchemaError(f"mechanics {mechanics.name} moves {mechanics.axes} axes, and axes has "
                          f"{len(document.axes)}", "give as many")
    return AxesPlantConfig({axis: _of_sections(sections, f"axes.{axis}.")
                            for axis, sections in document.axes.items()}, mechanics)


def _effect(where: str, content: dict[str, Any], known: Mapping[str, type[Effect]]) -> Effect:
    name = content.get("effect")
    if not isinstance(name, str) or name not in known:
        raise SchemaError(f"{where}.effect names an unknown effect (found {quoted(name)})",
                          f"known are {', '.join(known)}")
    try:
        kind = known[name]
    except ValueError as error:
        raise _schema_error(f"{where}: {error}") from None
    part = check(effect_schema(kind), content, f"{where} {name}: ", PlantDocument.RENEW)
    values = {field.name: getattr(part, field.name).value for field in dataclasses.fields(kind)}
    return kind(**{name: tuple(value) if isinstance(value, list) else value
                   for name, value in values.items()})


def _known_effects() -> Mapping[str, type[Effect]]:
    """Return effects and faults by name, those of this package first."""
    try:
        return registered(GROUP, EFFECTS | BEAM_EFFECTS | FAULTS)
    except ValueError as error:
        raise _schema_error(str(error)) from None


def _schema_error(text: str) -> SchemaError:
    problem, _, cure = text.rpartition(": ")
    return SchemaError(problem, cure)
