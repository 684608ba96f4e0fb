# SPDX-License-Identifier: BSD-3-Clause
"""A stage behind a digital piezo controller of Physik Instrumente, by the package ``pipython``.

The commands are those of GCS 2.0, as described in the manuals of E-709, E-727 and their family. The
wave generator of each axis plays a table of points, each for a number of servo cycles. One command
(WGO) starts the generators of all axes, and the data recorder in the same cycle. The servo is off,
so the points are control values of the open loop.
"""

import importlib
import time
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from piezo_common.schema import Document, Number, Part, Positive, entry, violation
from piezo_stage_driver.backends.axes_file import check_axes
from piezo_stage_driver.backends.registry import BackendSettings
from piezo_stage_driver.backends.stored_waveforms import (
    StoredWaveformStage,
    settings_of,
    whole_divider,
)

# Parameters and codes of GCS 2.0.
SERVO_UPDATE_TIME_S = 0x0E000200
RECORD_POINTS = 0x16000200
CURRENT_POSITION = 2
START, STOP = 1, 0
READ_POLL_S = 0.01


class PiAxis(Part):
    """What belongs to one axis of a controller."""

    axis: str = entry("Axis of the controller.")
    output_channel: int = entry("Piezo channel whose voltage is recorded.", at_least=1)
    wave_generator: int = entry("Wave generator of the axis.", at_least=1)
    wave_table: int = entry("Wave table that the backend overwrites.", at_least=1)
    control_per_v: Number = entry("Open-loop control value per volt at the stage; not 0.")
    control_at_0_v: Number = entry("Open-loop control value at 0 V.")
    displacement_um_per_unit: Number = entry(
        "Displacement per unit of the controller's position; not 0.", unit="um")

    @model_validator(mode="after")
    def _check_together(self) -> "PiAxis":
        for name in ("control_per_v", "displacement_um_per_unit"):
            if getattr(self, name) == 0.0:
                raise violation("is 0", "measure it", name)
        return self


class PiDocument(Document):
    """Settings that all axes of a controller share."""

    TITLE: ClassVar[str] = "settings of the backend pi_gcs"
    SYNTAX: ClassVar[str] = "yaml"
    RENEW: ClassVar[str] = "add it"

    controller: str = entry("Name by which pipython knows the controller, such as E-727.")
    interface: Literal["tcpip", "usb"] = entry("How the controller is connected.")
    address: str = entry("Host name or IP address; with usb the serial number.")
    voltage_record_option: int = entry(
        "Record option of the output channel's voltage, from the answer to HDR?; 7 on many.",
        at_least=1)
    points_per_command: int = entry("Wave points in one command.", at_least=1)
    longest_program_samples: int = entry(
        "Longest waveform with its ramps; the stage is ahead by so much.", at_least=1)
    transfer_s: Positive = entry("What storing a waveform and reading its record may take.",
                                 unit="s")


class PiSettings(PiAxis, PiDocument):
    """Settings of a controller that drives one axis."""

    @property
    def by_axis(self) -> dict[str, PiAxis]:
        """Return the only axis, without a name."""
        return {"": self}


class PiAxesSettings(PiDocument):
    """Settings of a controller that drives several axes."""

    axes: dict[str, PiAxis] = entry(
        "What belongs to each axis, by its short lower-case name.", shortest=2, longest=3)

    @model_validator(mode="after")
    def _check_axes(self) -> "PiAxesSettings":
        check_axes(self.axes, ("axis", "output_channel", "wave_generator", "wave_table"))
        return self

    @property
    def by_axis(self) -> dict[str, PiAxis]:
        """Return the axes by their names."""
        return self.axes


def load_library() -> SimpleNamespace:
    """Return the parts of the package ``pipython`` that are needed; ValueError if it is missing."""
    try:
        pipython = importlib.import_module("pipython")
        sockets = importlib.import_module("pipython.pidevice.interfaces.pisocket")
    except ImportError as error:
        raise ValueError(f"the backend pi_gcs needs the Python package pipython ({error}): "
                         "install it by pip") from None
    return SimpleNamespace(GCSDevice=pipython.GCSDevice, Error=pipython.GCSError,
                           Socket=sockets.PISocket)


class PiController:
    """A controller of PI as a `WaveformInstrument`.

    Every command and every question names all axes, so the controller moves and reads them
    together.
    """

    name = "pi_gcs"
    failures: tuple[type[Exception], ...]

    def __init__(self, settings: PiSettings | PiAxesSettings,
                 library: SimpleNamespace | None = None):
        self._settings = settings
        self._library = library or load_library()
        self.failures = (self._library.Error, OSError, SystemError)
        self._device: Any = None
        self.axes = tuple(filter(None, settings.by_axis))
        axes = settings.by_axis.values()
        self._axes = [own.axis for own in axes]
        self._channels = [own.output_channel for own in axes]
        self._generators = [own.wave_generator for own in axes]
        self._wave_tables = [own.wave_table for own in axes]
        self._control_per_v = np.array([own.control_per_v for own in axes])
        self._control_at_0_v = np.array([own.control_at_0_v for own in axes])
        self._um_per_unit = np.array([own.displacement_um_per_unit for own in axes])
        # The positions of all axes are recorded first, then their voltages.
        self._record_tables = list(range(1, 2 * len(axes) + 1))

    def open(self, sample_rate_hz: float, samples: int) -> None:
        """Connect, switch the servos off, and set the rates; see `WaveformInstrument`."""
        controller, axes = self._settings.controller, self._axes
        self._device = device = self._connected()
        known = device.qSAI()
        for axis in axes:
            if axis not in known:
                raise ValueError(f"{controller} has no axis {axis}, only {', '.join(known)}: "
                                 "mend axis in the settings")
        device.SVO(axes, [False] * len(axes))
        for axis, closed in device.qSVO(axes).items():
            if closed:
                raise ValueError(f"{controller}: the servo of axis {axis} stays on: switch it off "
                                 "at the controller")
        servo_s = float(device.qSPA(axes[0], SERVO_UPDATE_TIME_S)[axes[0]][SERVO_UPDATE_TIME_S])
        divider = whole_divider(1.0 / servo_s, sample_rate_hz, controller)
        tables, needed = device.qTNR(), self._record_tables
        if tables < len(needed):
            raise ValueError(f"{controller} has {tables} record tables, a position and a voltage "
                             f"of each axis need {len(needed)}: set more at the controller")
        table_samples = int(device.qSPA(axes[0], RECORD_POINTS)[axes[0]][RECORD_POINTS]) // tables
        if samples > table_samples:
            raise ValueError(f"{controller} records {table_samples} samples at a time: "
                             "set longest_program_samples to no more, or fewer record tables")
        device.WTR(self._generators, [divider] * len(axes), [0] * len(axes))
        device.RTR(divider)
        device.DRC(needed, axes + self._channels, [CURRENT_POSITION] * len(axes) + [
            self._settings.voltage_record_option] * len(axes))

    def start(self, voltage_v: np.ndarray) -> None:
        """Write the wave tables, and start all once; see `WaveformInstrument`."""
        device, generators = self._device, self._generators
        self._samples = len(voltage_v)
        device.WCL(self._wave_tables)
        for table, points in zip(
                self._wave_tables, self._control(voltage_v).T.tolist(), strict=True):
            self._write_points(table, points)
        device.WSL(generators, self._wave_tables)
        device.WGC(generators, [1] * len(generators))
        device.WGO(generators, [START] * len(generators))

    def running(self) -> bool:
        """Return whether a generator runs, or points are still missing."""
        if any(self._device.IsGeneratorRunning(self._generators).values()):
            return True
        return min(self._device.qDRL(self._record_tables).values()) < self._samples

    def recorded(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Read all record tables; see `WaveformInstrument`."""
        device = self._device
        device.qDRR(self._record_tables, 1, samples)
        while device.bufstate is not True:
            time.sleep(READ_POLL_S)
        position, voltage_v = np.split(np.asarray(device.bufdata, dtype=float)[:, :samples].T,
                                       2, axis=1)
        return voltage_v, self._um_per_unit * position

    def displacement_um(self) -> np.ndarray:
        """Read the positions once (um)."""
        return self._um_per_unit * _values(self._device.qPOS(self._axes))

    def held_v(self) -> np.ndarray:
        """Read the voltages of the output channels (V)."""
        return _values(self._device.qVOL(self._channels))

    def hold(self, voltage_v: np.ndarray) -> None:
        """Command control values (SVA)."""
        self._device.SVA(self._axes, self._control(voltage_v).tolist())

    def halt(self) -> None:
        """Stop all wave generators."""
        self._device.WGO(self._generators, [STOP] * len(self._generators))

    def close(self) -> None:
        """Disconnect from the controller."""
        device, self._device = self._device, None
        if device is not None:
            # Its method close leaves a callback behind, which fails in the next connection.
            device.__exit__(None, None, None)

    def _write_points(self, table: int, points: list[float]) -> None:
        longest = self._settings.points_per_command
        for first in range(0, len(points), longest):
            part = points[first:first + longest]
            self._device.WAV_PNT(table, first + 1, len(part), "&" if first else "X", part)

    def _control(self, voltage_v: np.ndarray) -> np.ndarray:
        return self._control_per_v * voltage_v + self._control_at_0_v

    def _connected(self) -> Any:
        settings, library = self._settings, self._library
        if settings.interface == "tcpip":  # without the vendor's shared library
            return library.GCSDevice(gateway=library.Socket(settings.address))
        device = library.GCSDevice(settings.controller)
        device.ConnectUSB(settings.address)
        return device


def _values(by_item: Mapping[Any, float]) -> np.ndarray:
    return np.array(list(by_item.values()), dtype=float)


def create(settings: BackendSettings) -> StoredWaveformStage:
    """Create the backend from its settings; the entry point ``pi_gcs``.

    Raises ValueError if the file is missing or invalid, or the library is missing.
    """
    own = settings_of("pi_gcs", PiSettings, PiAxesSettings, settings)
    return StoredWaveformStage(
        PiController(own), settings, own.longest_program_samples, own.transfer_s)
