# SPDX-License-Identifier: BSD-3-Clause
"""The model file of several axes: version 2 of the model file, which has `axes`."""

from os import PathLike
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from piezo_common.arrays import ComplexArray
from piezo_common.schema import (
    Document,
    NotNegative,
    Number,
    Numbers,
    Part,
    Positive,
    SchemaError,
    checked,
    entry,
    load_document,
    violation,
)
from piezo_models.axes.actuator import Actuator
from piezo_models.axes.coupled import CoupledModel, Softening
from piezo_models.axes.identified_axes import Coupling, IdentifiedAxes
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.linear.dynamics import CreepDynamics
from piezo_models.model_document import (
    FORMAT,
    CreepPart,
    Deviation,
    HysteresisPart,
    ModelFileError,
    RecordingPart,
    document_of_creep,
    document_of_hysteresis,
)
from piezo_models.model_file import LARGEST_FILE_BYTES, write_document
from piezo_models.model_reader import built_hysteresis

VERSION = 2

Matrix = list[Numbers]
"""Rows: the axis that moves; columns: the axis that is driven."""


class ModePart(Part):
    """A mode that all axes share: a conjugate pair of poles, or a real one of damping ratio 1."""

    frequency_rad_per_s: Positive = entry("Size of the pole.", unit="rad/s")
    damping_ratio: Positive = entry("Damping ratio, at most 1.", unit="1")
    residue_re_um_per_v: Matrix = entry(
        "Real part of its residue in the sampled response.", unit="um/V")
    residue_im_um_per_v: Matrix = entry("Imaginary part.", unit="um/V")
    pole_deviation_rad_per_s: list[NotNegative] = entry(
        "Standard deviation of the pole's real and imaginary part.", unit="rad/s", shortest=2,
        longest=2)
    residue_deviation_re_um_per_v: Matrix = entry(
        "Standard deviation of the residue's real part.", unit="um/V")
    residue_deviation_im_um_per_v: Matrix = entry("Of its imaginary part.", unit="um/V")


class SofteningPart(Part):
    """Stiffness, damping and gain that depend on the amplitude of the voltage."""

    elongation_re: list[list[Matrix]] = entry(
        "Real part of the residues by which the elongation acts back on the voltage, by power of "
        "the amplitude and mode.", unit="1")
    elongation_im: list[list[Matrix]] = entry("Imaginary part.", unit="1")
    gain: list[Matrix] = entry("Part of the voltage itself, by power.", unit="1")
    reference_v: Positive = entry("RMS voltage at which the linear part holds.", unit="V")
    memory_s: Positive = entry("Time constant of the running RMS.", unit="s")
    range_v: list[NotNegative] = entry(
        "RMS voltages of the identification.", unit="V", shortest=2, longest=2)


class BoucWenPart(Part):
    """A Bouc-Wen hysteresis of the voltage, see the effect `bouc_wen_hysteresis`."""

    saturation_v: Positive = entry("Largest voltage that it takes.", unit="V")
    relaxation_v: Positive = entry("Voltage over which it takes it.", unit="V")
    unloading: NotNegative = entry("Factor of the decrease at a reversal.", unit="1")
    exponent: Positive = entry("How sharply it saturates.", unit="1", default=1.0)


class ActuatorPart(Part):
    """Hysteresis and creep in front of the modes on one axis."""

    hysteresis: HysteresisPart | None = entry(
        "Hysteresis. Its output over its mean slope is the voltage that it passes on; left out "
        "where the voltage passes as it is.", default=None)
    creep: CreepPart = entry("Creep of the voltage behind it.")
    amplifier_lag_s: NotNegative = entry(
        "Time constant of the amplifier in front of it, which is also a pole of the modes.",
        unit="s", default=0.0)
    bouc_wen: BoucWenPart | None = entry(
        "Hysteresis whose loops drift, in front of the other one.", default=None)


class CouplingPart(Part):
    """The response at one frequency, with its standard deviation."""

    frequency_hz: NotNegative = entry("Frequency.", unit="Hz")
    re_um_per_v: Matrix = entry("Real part.", unit="um/V")
    im_um_per_v: Matrix = entry("Imaginary part.", unit="um/V")
    deviation_re_um_per_v: Matrix = entry("Standard deviation of the real part.", unit="um/V")
    deviation_im_um_per_v: Matrix = entry("Of the imaginary part.", unit="um/V")


class AxesDocument(Document):
    """The model file of several axes, readable by eye."""

    TITLE: ClassVar[str] = "model file of several axes"
    FORMAT: ClassVar[str] = FORMAT
    VERSION: ClassVar[int] = VERSION
    RENEW: ClassVar[str] = (
        "give a model of several axes, identified with this release; version 1 is of one axis")

    format: str = entry(f"Always {FORMAT}.")
    version: Number = entry(f"Always {VERSION}.")
    created: str = entry("Time of creation, ISO 8601.")
    axes: list[str] = entry("Names of the axes.", shortest=2)
    sample_period_s: Positive = entry("Sample period of the model.", unit="s")
    operating_voltage_v: Numbers = entry("Voltage of each axis about which it holds.", unit="V")
    operating_displacement_um: Numbers = entry("Displacement there.", unit="um")
    voltage_range_v: list[Numbers] = entry("Lowest and highest voltage of each axis.", unit="V")
    latency_samples: list[NotNegative] = entry("Whole samples by which each sensor is late.")
    delays_s: Numbers = entry("Delay of each sensor, by the phases of the modes.", unit="s")
    delay_deviations_s: list[Deviation] = entry(
        "Standard deviations; null where no mode determines it.", unit="s")
    modes: list[ModePart] = entry("Modes.")
    direct_um_per_v: list[Matrix] = entry(
        "Motion with the voltage of the same sample, the one before, and so on.", unit="um/V")
    softening: SofteningPart | None = entry(
        "What changes with the amplitude of the voltage.", default=None)
    actuators: list[ActuatorPart] = entry(
        "Hysteresis and creep of each axis; left out where no axis has any.", default=[])
    coupling: list[CouplingPart] = entry("The response of the modes at some frequencies.")
    errors: dict[str, dict[str, Number]] = entry(
        "Errors of each axis on data that was not fitted, units in the names.")
    recordings: list[RecordingPart] = entry("Where the model came from.")
    unfinished: str = entry("Why the identification ended early.", default="")

    @model_validator(mode="after")
    def _check_shapes(self) -> "AxesDocument":
        n = len(self.axes)
        for number, mode in enumerate(self.modes):
            for name, value in mode:
                if name.startswith("residue") and np.shape(_ragged(value)) != (n, n):
                    raise violation(f"is no matrix of {n} by {n}", f"give {n} rows of {n} numbers",
                                    f"modes[{number}].{name}")
            if mode.damping_ratio > 1.0:
                raise violation("is more than 1", "give two real modes", f"modes[{number}]")
        if len(self.actuators) not in (0, n):
            raise violation(f"is not a list of {n} objects", "give one for each axis", "actuators")
        return self


def save_axes_model(path: str | PathLike[str], identified: IdentifiedAxes) -> None:
    """Write a model file of several axes; the file at `path` is replaced in one step or not at all.

    Raises
    ------
    ModelFileError
        If the file cannot be written, or a file that is not a model file is in its place.
    """
    document = _document_of(identified)
    checked(AxesDocument, document)
    write_document(Path(path), document)


def load_axes_model(path: str | PathLike[str]) -> IdentifiedAxes:
    """Read a model file of several axes.

    Raises
    ------
    ModelFileError
        If the file is missing, is not a model file of this version, or has an invalid field.
    """
    try:
        return _built(load_document(AxesDocument, path, LARGEST_FILE_BYTES))
    except (SchemaError, ValueError) as error:
        raise ModelFileError(f"{path}: {error}") from None


def _document_of(identified: IdentifiedAxes) -> dict[str, Any]:
    model, coupling = identified.model, identified.coupling
    modes = [
        {"frequency_rad_per_s": float(abs(pole)), "damping_ratio": float(-pole.real / abs(pole)),
         "residue_re_um_per_v": residue.real.tolist(), "residue_im_um_per_v": residue.imag.tolist(),
         "pole_deviation_rad_per_s": [float(pole_off.real), float(pole_off.imag)],
         "residue_deviation_re_um_per_v": off.real.tolist(),
         "residue_deviation_im_um_per_v": off.imag.tolist()}
        for pole, residue, pole_off, off in zip(
            model.poles_rad_per_s, model.residues_um_per_v, identified.pole_deviations_rad_per_s,
            identified.residue_deviations_um_per_v, strict=True)]
    actuators = {} if not model.actuators else {"actuators": [
        {**({} if each.hysteresis is None else {
            "hysteresis": document_of_hysteresis(each.hysteresis)}),
         **({"amplifier_lag_s": each.lag_s} if each.lag_s else {}),
         **({"bouc_wen": each.bouc_wen.parameters()} if each.bouc_wen else {}),
         "creep": document_of_creep(each.creep)} for each in model.actuators]}
    softening = {} if model.softening is None else {"softening": {
        "elongation_re": model.softening.elongations.real.tolist(),
        "elongation_im": model.softening.elongations.imag.tolist(),
        "gain": model.softening.gain.tolist(), "reference_v": model.softening.reference_v,
        "memory_s": model.softening.memory_s, "range_v": list(model.softening.range_v)}}
    return {
        "format": FORMAT, "version": VERSION, "created": identified.created,
        "axes": list(model.axes), "sample_period_s": model.sample_period_s,
        **{name: getattr(model, name).tolist() for name in (
            "operating_voltage_v", "operating_displacement_um", "latency_samples")},
        "voltage_range_v": identified.voltage_range_v.tolist(),
        "delays_s": identified.delays_s.tolist(),
        "delay_deviations_s": [off_s if np.isfinite(off_s) else None
                               for off_s in identified.delay_deviations_s.tolist()],
        "modes": modes, "direct_um_per_v": model.direct_um_per_v.tolist(), **softening, **actuators,
        "coupling": [
            {"frequency_hz": float(frequency_hz), "re_um_per_v": gain.real.tolist(),
             "im_um_per_v": gain.imag.tolist(), "deviation_re_um_per_v": off.real.tolist(),
             "deviation_im_um_per_v": off.imag.tolist()}
            for frequency_hz, gain, off in zip(
                coupling.frequency_hz, coupling.gain_um_per_v, coupling.deviation_um_per_v,
                strict=True)],
        "errors": identified.errors, "recordings": list(identified.recordings),
        **({"unfinished": identified.unfinished} if identified.unfinished else {})}


def _built(document: AxesDocument) -> IdentifiedAxes:
    n, modes = len(document.axes), document.modes
    size = np.array([mode.frequency_rad_per_s for mode in modes])
    damping = np.array([mode.damping_ratio for mode in modes])
    softening = document.softening
    model = CoupledModel(
        tuple(document.axes), document.sample_period_s,
        size * (-damping + 1j * np.sqrt(np.maximum(1.0 - damping**2, 0.0))),
        _complex([mode.residue_re_um_per_v for mode in modes],
                 [mode.residue_im_um_per_v for mode in modes]).reshape(-1, n, n),
        np.array(document.direct_um_per_v), np.array(document.latency_samples, dtype=int),
        np.array(document.operating_voltage_v), np.array(document.operating_displacement_um),
        None if softening is None else Softening(
            _complex(softening.elongation_re, softening.elongation_im), np.array(softening.gain),
            softening.reference_v, softening.memory_s,
            (softening.range_v[0], softening.range_v[1])),
        tuple(Actuator(
            None if part.hysteresis is None else built_hysteresis(part.hysteresis),
            CreepDynamics(tuple(part.creep.poles_rad_per_s), tuple(part.creep.zeros_rad_per_s)),
            part.amplifier_lag_s,
            None if part.bouc_wen is None else BoucWenHysteresis(**dict(part.bouc_wen)))
            for part in document.actuators))
    coupling = Coupling(
        np.array([each.frequency_hz for each in document.coupling]),
        _complex([each.re_um_per_v for each in document.coupling],
                 [each.im_um_per_v for each in document.coupling]),
        _complex([each.deviation_re_um_per_v for each in document.coupling],
                 [each.deviation_im_um_per_v for each in document.coupling]))
    pole_off = np.array([mode.pole_deviation_rad_per_s for mode in modes]).reshape(-1, 2)
    return IdentifiedAxes(
        model, np.array(document.voltage_range_v), coupling, pole_off[:, 0] + 1j * pole_off[:, 1],
        _complex([mode.residue_deviation_re_um_per_v for mode in modes],
                 [mode.residue_deviation_im_um_per_v for mode in modes]).reshape(-1, n, n),
        np.array(document.delays_s),
        np.array([np.inf if off_s is None else off_s for off_s in document.delay_deviations_s]),
        document.errors,
        [dict(recording) for recording in document.recordings], document.created,
        document.unfinished)


def _complex(real: ArrayLike, imaginary: ArrayLike) -> ComplexArray:
    return np.asarray(real, dtype=float) + 1j * np.asarray(imaginary, dtype=float)


def _ragged(rows: Any) -> Any:
    """Return rows of equal length as an array, else an empty list."""
    return np.array(rows) if len({len(row) for row in rows}) == 1 else []
