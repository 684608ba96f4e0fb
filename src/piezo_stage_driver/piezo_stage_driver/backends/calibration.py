# SPDX-License-Identifier: BSD-3-Clause
"""Calibration file of a stage behind a data acquisition card."""

import math
from dataclasses import dataclass, fields

import yaml

from piezo_common.text_file import UnreadableFile, read_bounded_text

# Of NI-DAQmx.
TERMINALS = ("DEFAULT", "DIFF", "RSE", "NRSE", "PSEUDO_DIFF")


class CalibrationError(ValueError):
    """A calibration file that cannot be used; the message says where and what to do."""


@dataclass(frozen=True)
class Calibration:
    """From volts at the card to volts at the stage and to um.

    Attributes
    ----------
    output_channel, input_channel : str
        Physical channels, such as ``Dev1/ao0``; on one device.
    terminal_configuration : str
        Of the input: ``DEFAULT``, ``DIFF``, ``RSE``, ``NRSE`` or ``PSEUDO_DIFF``.
    amplifier_gain : float
        Volts at the stage per volt at the card.
    amplifier_offset_v : float
        Volts at the stage for 0 V at the card.
    output_minimum_v, output_maximum_v : float
        Range of the card's output.
    sensor_um_per_v : float
        Displacement per volt at the card.
    sensor_offset_um : float
        Displacement for 0 V at the card.
    input_minimum_v, input_maximum_v : float
        Range of the card's input.
    lead_ticks : int
        How far the output is written ahead: what the computer may be late without a stop, and
        what every answer and every stop is later.
    """

    output_channel: str
    input_channel: str
    terminal_configuration: str
    amplifier_gain: float
    amplifier_offset_v: float
    output_minimum_v: float
    output_maximum_v: float
    sensor_um_per_v: float
    sensor_offset_um: float
    input_minimum_v: float
    input_maximum_v: float
    lead_ticks: int

    @property
    def device(self):
        """Name of the card."""
        return self.input_channel.split("/")[0]

    @property
    def voltage_range_v(self):
        """Lowest and highest voltage at the stage that the card can ask for."""
        return tuple(sorted(self.voltage_v(card_v)
                            for card_v in (self.output_minimum_v, self.output_maximum_v)))

    def card_v(self, voltage_v):
        """Volts at the card's output for volts at the stage."""
        return (voltage_v - self.amplifier_offset_v) / self.amplifier_gain

    def voltage_v(self, card_v):
        """Volts at the stage for volts at the card's output."""
        return self.amplifier_gain * card_v + self.amplifier_offset_v

    def displacement_um(self, card_v):
        """Displacement for volts at the card's input."""
        return self.sensor_um_per_v * card_v + self.sensor_offset_um


def load_calibration(path):
    """Read a calibration file (YAML); every entry of `Calibration` must be in it.

    Raises
    ------
    CalibrationError
        If the file cannot be read, or an entry is unknown, missing or impossible.
    """
    try:
        content = yaml.safe_load(read_bounded_text(path))
    except UnreadableFile as error:
        raise CalibrationError(f"{path}: the calibration {error}") from None
    except (yaml.YAMLError, RecursionError) as error:
        raise CalibrationError(f"{path}: no YAML file: {' '.join(str(error).split())}") from None
    names = [field.name for field in fields(Calibration)]
    if not isinstance(content, dict):
        raise CalibrationError(f"{path}: give the entries {', '.join(names)}")
    for name in content:
        if name not in names:
            raise CalibrationError(f"{path}: unknown entry {name!r}; known are {', '.join(names)}")
    for field in fields(Calibration):
        if field.name not in content:
            raise CalibrationError(f"{path}: {field.name} is missing: add it")
        _check_type(path, field, content[field.name])
    return _checked(path, Calibration(**content))


def _check_type(path, field, value):
    fits = {str: isinstance(value, str),
            int: type(value) is int,
            float: type(value) in (int, float) and math.isfinite(value)}[field.type]
    if not fits:
        wanted = {str: "a text", int: "a whole number", float: "a finite number"}[field.type]
        raise CalibrationError(f"{path}: {field.name} is {value!r}: give {wanted}")


def _checked(path, calibration):
    for sentence, holds in {
        f"terminal_configuration is none of {', '.join(TERMINALS)}":
            calibration.terminal_configuration in TERMINALS,
        "amplifier_gain is 0": calibration.amplifier_gain != 0.0,
        "sensor_um_per_v is 0": calibration.sensor_um_per_v != 0.0,
        "lead_ticks is below 1: the card needs its samples in advance": calibration.lead_ticks >= 1,
        "output_minimum_v is not below output_maximum_v":
            calibration.output_minimum_v < calibration.output_maximum_v,
        "input_minimum_v is not below input_maximum_v":
            calibration.input_minimum_v < calibration.input_maximum_v,
        "output_channel and input_channel are not on one device":
            calibration.output_channel.split("/")[0] == calibration.device,
    }.items():
        if not holds:
            raise CalibrationError(f"{path}: {sentence}")
    return calibration
