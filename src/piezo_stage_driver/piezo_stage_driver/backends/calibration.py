# SPDX-License-Identifier: BSD-3-Clause
"""Calibration file of a stage behind a data acquisition card."""

from os import PathLike
from typing import ClassVar, TypeVar

import numpy as np
from pydantic import model_validator

from piezo_common.schema import Document, Number, Part, SchemaError, entry, violation
from piezo_stage_driver.backends.axes_file import check_axes, load_axes_file

# Terminal configurations of NI-DAQmx.
TERMINALS = ("DEFAULT", "DIFF", "RSE", "NRSE", "PSEUDO_DIFF")


Volts = TypeVar("Volts", float, np.ndarray)


class CalibrationError(ValueError):
    """A calibration file that cannot be used; the message says where and what to do."""


class AxisCalibration(Part):
    """Conversion of one axis from volts at the card to volts at the stage and to um."""

    output_channel: str = entry("Physical channel of the card that drives the amplifier.")
    input_channel: str = entry("Physical channel of the card that reads the sensor.")
    terminal_configuration: str = entry(f"Wiring of the input: {', '.join(TERMINALS)}.")
    amplifier_gain: Number = entry("Volts at the stage per volt at the card; not 0.", unit="V/V")
    amplifier_offset_v: Number = entry("Voltage at the stage for 0 V at the card.", unit="V")
    output_minimum_v: Number = entry("Lowest output of the card.", unit="V")
    output_maximum_v: Number = entry("Highest output of the card.", unit="V")
    sensor_um_per_v: Number = entry("Displacement per volt at the card; not 0.", unit="um/V")
    sensor_offset_um: Number = entry("Displacement for 0 V at the card.", unit="um")
    input_minimum_v: Number = entry("Lowest input of the card.", unit="V")
    input_maximum_v: Number = entry("Highest input of the card.", unit="V")

    @model_validator(mode="after")
    def _check_together(self) -> "AxisCalibration":
        if self.terminal_configuration not in TERMINALS:
            raise violation(f"is none of {', '.join(TERMINALS)}", "give one of them",
                            "terminal_configuration")
        for name in ("amplifier_gain", "sensor_um_per_v"):
            if getattr(self, name) == 0.0:
                raise violation("is 0", "measure it", name)
        for name in ("output", "input"):
            if getattr(self, f"{name}_minimum_v") >= getattr(self, f"{name}_maximum_v"):
                raise violation(f"is not below {name}_maximum_v", "give the lower one first",
                                f"{name}_minimum_v")
        if self.output_channel.split("/")[0] != self.device:
            raise violation("is not on the device of input_channel", "use channels of one card",
                            "output_channel")
        return self

    @property
    def device(self) -> str:
        """Return the name of the card."""
        return self.input_channel.split("/")[0]

    @property
    def voltage_range_v(self) -> tuple[float, float]:
        """Return the lowest and highest voltage at the stage that the card can produce."""
        ends_v = (self.voltage_v(self.output_minimum_v), self.voltage_v(self.output_maximum_v))
        return min(ends_v), max(ends_v)

    def card_v(self, voltage_v: Volts) -> Volts:
        """Return the volts at the card's output for volts at the stage."""
        return (voltage_v - self.amplifier_offset_v) / self.amplifier_gain

    def voltage_v(self, card_v: Volts) -> Volts:
        """Return the volts at the stage for volts at the card's output."""
        return self.amplifier_gain * card_v + self.amplifier_offset_v

    def displacement_um(self, card_v: Volts) -> Volts:
        """Return the displacement (um) for volts at the card's input."""
        return self.sensor_um_per_v * card_v + self.sensor_offset_um


class CardDocument(Document):
    """Entries of a card, whatever the number of axes."""

    TITLE: ClassVar[str] = "calibration file"
    SYNTAX: ClassVar[str] = "yaml"
    RENEW: ClassVar[str] = "add it"

    lead_ticks: int = entry("How many ticks ahead the output is written.",
                            at_least=1, at_most=1_000_000_000)
    mark_lines: str = entry("Digital lines that put out the marks, from line 0 of a port: pixel, "
                            "line, frame and backward; none by default.", default="")


class Calibration(AxisCalibration, CardDocument):
    """The calibration of a stage of one axis.

    The output is written `lead_ticks` ahead. That is the tolerated delay of the computer, which
    also delays every answer and every stop.
    """

    @property
    def by_axis(self) -> dict[str, AxisCalibration]:
        """Return the only axis, without a name."""
        return {"": self}


class AxesCalibration(CardDocument):
    """The calibration of a stage of several axes on one card."""

    axes: dict[str, AxisCalibration] = entry(
        "Channels and factors of each axis, by its short lower-case name.", shortest=2, longest=3)

    @model_validator(mode="after")
    def _check_axes(self) -> "AxesCalibration":
        first = next(iter(self.axes.values()))
        for axis, own in self.axes.items():
            if own.device != first.device:
                raise violation(f"is on {own.device}, another axis on {first.device}",
                                "use channels of one card", f"axes.{axis}.input_channel")
        check_axes(self.axes, ("output_channel", "input_channel"))
        return self

    @property
    def by_axis(self) -> dict[str, AxisCalibration]:
        """Return the axes by their names."""
        return self.axes


def load_calibration(path: str | PathLike[str]) -> Calibration | AxesCalibration:
    """Read a calibration file (YAML) of one axis, or of several if it has `axes`.

    Raises `CalibrationError` if it cannot be read, or an entry is unknown, missing or impossible.
    """
    try:
        return load_axes_file(Calibration, AxesCalibration, path)
    except SchemaError as error:
        raise CalibrationError(f"{path}: {error}") from None
