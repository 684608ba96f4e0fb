# SPDX-License-Identifier: BSD-3-Clause
"""Strict reading of a plant file: every parameter with value, unit and source."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import yaml

from piezo_common.registered import registered
from piezo_sim.effects.current_limit import CurrentLimit
from piezo_sim.effects.depolarisation import Depolarisation
from piezo_sim.effects.distributed_lag import DistributedLag
from piezo_sim.effects.hardening_spring import HardeningSpring
from piezo_sim.effects.intermittent_contact import IntermittentContact
from piezo_sim.effects.logarithmic_creep import LogarithmicCreep
from piezo_sim.effects.mains_hum import MainsHum
from piezo_sim.effects.parallel_mode import ParallelMode
from piezo_sim.effects.self_heating import SelfHeating
from piezo_sim.effects.soft_backlash import SoftBacklash
from piezo_sim.effects.soft_saturation import SoftSaturation
from piezo_sim.effects.spikes import Spikes
from piezo_sim.effects.switching_delay import SwitchingDelay
from piezo_sim.effects.thermal_drift import ThermalDrift
from piezo_sim.effects.transducer_curve import TransducerCurve
from piezo_sim.effects.transport_delay import TransportDelay
from piezo_sim.faults.device_failure import DeviceFailure
from piezo_sim.faults.sensor_faults import NoisySensor, OffScaleSensor, SilentSensor, StuckSensor
from piezo_sim.plant.amplifier import VoltageAmplifier
from piezo_sim.plant.continuous_preisach import PreisachHysteresis
from piezo_sim.plant.linear_effects import Creep, ElectricLag, VibrationMode
from piezo_sim.plant.plant_effect import Effect, PlantConfigError
from piezo_sim.plant.sensor import DisplacementSensor

GROUP = "piezo_sim.effects"
"""Entry points by which other packages offer effects of the plant."""

# A further effect of the plant is one new module and one more entry here.
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
        HardeningSpring,
        SoftBacklash,
        Spikes,
        SelfHeating,
        IntermittentContact,
        Depolarisation,
    )
}

# What breaks down, and when; in the section sensor, behind what is to break.
FAULTS = {
    fault.name: fault
    for fault in (StuckSensor, SilentSensor, OffScaleSensor, NoisySensor, DeviceFailure)
}


@dataclass(frozen=True)
class PlantConfig:
    """Effects of the plant, each section in the order in which the signal passes it.

    Attributes
    ----------
    amplifier : tuple of piezo_sim.plant.plant_effect.Effect
        From the commanded voltage to the applied voltage, V.
    stage : tuple of piezo_sim.plant.plant_effect.Effect
        From the applied voltage, V, to the true displacement, um.
    sensor : tuple of piezo_sim.plant.plant_effect.Effect
        From the true displacement to the measured displacement, um.
    """

    amplifier: tuple[Effect, ...]
    stage: tuple[Effect, ...]
    sensor: tuple[Effect, ...]


def read_plant(path: str | Path | None = None) -> PlantConfig:
    """Read a plant file.

    Parameters
    ----------
    path : path-like, optional
        YAML file; by default the plant of thesis chapter 4 that comes with this package.

    Raises
    ------
    PlantConfigError
        If the file cannot be read, or a section, effect or parameter is unknown, missing, without
        unit or source, not finite, or impossible.
    """
    file = resources.files("piezo_sim") / "plant.yaml" if path is None else Path(path)
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise PlantConfigError(f"{file}: the plant file cannot be read: {reason}.") from None
    try:
        return parse_plant(text)
    except PlantConfigError as error:
        raise PlantConfigError(f"{file}: {error}") from None


def parse_plant(text: str) -> PlantConfig:
    """Parse the text of a plant file; see `read_plant`."""
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise PlantConfigError(f"not a YAML file: {' '.join(str(error).split())}.") from None
    sections = [field.name for field in dataclasses.fields(PlantConfig)]
    _check_names("the plant file", content, sections)
    return PlantConfig(
        **{
            section: tuple(
                _effect(f"{section}[{index}]", entry)
                for index, entry in enumerate(_list(section, content[section]))
            )
            for section in sections
        }
    )


def _list(where: str, value) -> list:
    if not isinstance(value, list) or not value:
        raise PlantConfigError(f"{where} must be a list of at least one effect.")
    return value


def _check_names(where: str, mapping, expected: list[str]) -> None:
    if not isinstance(mapping, dict):
        raise PlantConfigError(f"{where} must hold {', '.join(expected)}.")
    for name in mapping:
        if name not in expected:
            raise PlantConfigError(
                f"{where} has an unknown entry {name!r}; it may hold {', '.join(expected)}."
            )
    for name in expected:
        if name not in mapping:
            raise PlantConfigError(f"{where} lacks {name}; add it.")


def _effect(where: str, entry) -> Effect:
    name = entry.get("effect") if isinstance(entry, dict) else None
    known = _known_effects()
    if not isinstance(name, str) or name not in known:
        raise PlantConfigError(
            f"{where} names an unknown effect {name!r}; known are {', '.join(known)}."
        )
    where = f"{where} {name}"
    try:
        kind = known[name]
    except ValueError as error:
        raise PlantConfigError(f"{where}: {error}.") from None
    fields = dataclasses.fields(kind)
    _check_names(where, entry, ["effect"] + [field.name for field in fields])
    values = {field.name: _value(where, field, entry[field.name]) for field in fields}
    return kind(**values)


def _known_effects() -> Mapping[str, type[Effect]]:
    """Effects and faults by their names, those of other packages after those of this one."""
    try:
        return registered(GROUP, EFFECTS | FAULTS)
    except ValueError as error:
        raise PlantConfigError(f"{error}.") from None


def _value(where: str, field: dataclasses.Field, entry):
    where = f"{where}: {field.name}"
    _check_names(where, entry, ["value", "unit", "source"])
    unit = field.metadata["unit"]
    if entry["unit"] != unit:
        raise PlantConfigError(f"{where} has the unit {entry['unit']!r}; state it in {unit!r}.")
    if not isinstance(entry["source"], str) or not entry["source"].strip():
        raise PlantConfigError(f"{where} has no source; say where the value comes from.")
    value = entry["value"]
    if field.type is int:
        if type(value) is not int:
            raise PlantConfigError(f"{where} must be an integer, not {value!r}.")
        return value
    if field.type is float:
        return _number(where, value)
    if not isinstance(value, list):
        raise PlantConfigError(f"{where} must be a list of numbers, not {value!r}.")
    return tuple(_number(where, item) for item in value)


def _number(where: str, value) -> float:
    if type(value) not in (int, float):
        raise PlantConfigError(f"{where} must be a number, not {value!r}.")
    if not math.isfinite(value):
        raise PlantConfigError(f"{where} must be finite, not {value!r}.")
    return float(value)
