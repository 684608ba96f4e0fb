# SPDX-License-Identifier: BSD-3-Clause
"""A stage behind a digital piezo controller of Physik Instrumente, by the package ``pipython``.

The commands are those of GCS 2.0, as described in the manuals of E-709, E-727 and their family. The
wave generator plays a table of points, each for a number of servo cycles, and its start (WGO)
starts the data recorder in the same cycle. The servo is off, so the points are control values of
the open loop.
"""

import importlib
import time
from types import SimpleNamespace
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import model_validator

from piezo_common.schema import Document, Number, Positive, entry, violation
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
POSITION_TABLE, VOLTAGE_TABLE = 1, 2
START, STOP = 1, 0
READ_POLL_S = 0.01

Volts = TypeVar("Volts", float, np.ndarray)


class PiSettings(Document):
    """Settings of a controller."""

    TITLE: ClassVar[str] = "settings of the backend pi_gcs"
    SYNTAX: ClassVar[str] = "yaml"
    RENEW: ClassVar[str] = "add it"

    controller: str = entry("Name by which pipython knows the controller, such as E-727.")
    interface: Literal["tcpip", "usb"] = entry("How the controller is connected.")
    address: str = entry("Host name or IP address; with usb the serial number.")
    axis: str = entry("Axis of the controller.")
    output_channel: int = entry("Piezo channel whose voltage is recorded.", at_least=1)
    wave_generator: int = entry("Wave generator of the axis.", at_least=1)
    wave_table: int = entry("Wave table that the backend overwrites.", at_least=1)
    control_per_v: Number = entry("Open-loop control value per volt at the stage; not 0.")
    control_at_0_v: Number = entry("Open-loop control value at 0 V.")
    displacement_um_per_unit: Number = entry(
        "Displacement per unit of the controller's position; not 0.", unit="um")
    voltage_record_option: int = entry(
        "Record option of the output channel's voltage, from the answer to HDR?; 7 on many.",
        at_least=1)
    points_per_command: int = entry("Wave points in one command.", at_least=1)
    longest_program_samples: int = entry(
        "Longest waveform with its ramps; the stage is ahead by so much.", at_least=1)
    transfer_s: Positive = entry("What storing a waveform and reading its record may take.",
                                 unit="s")

    @model_validator(mode="after")
    def _check_together(self) -> "PiSettings":
        for name in ("control_per_v", "displacement_um_per_unit"):
            if getattr(self, name) == 0.0:
                raise violation("is 0", "measure it", name)
        return self


def load_library() -> SimpleNamespace:
    """Import the package ``pipython`` and return the parts that are needed.

    Raises
    ------
    ValueError
        If it is not installed.
    """
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

    Parameters
    ----------
    library : namespace, optional
        Library; the result of `load_library` by default.
    """

    name = "pi_gcs"
    failures: tuple[type[Exception], ...]

    def __init__(self, settings: PiSettings, library: SimpleNamespace | None = None):
        self._settings = settings
        self._library = library or load_library()
        self.failures = (self._library.Error, OSError, SystemError)
        self._device: Any = None

    def open(self, sample_rate_hz: float, samples: int) -> None:
        """Connect, switch the servo off, and set the rates; see `WaveformInstrument`."""
        settings = self._settings
        self._device = device = self._connected()
        device.SVO(settings.axis, False)
        if device.qSVO(settings.axis)[settings.axis]:
            raise ValueError(f"{settings.controller}: the servo of axis {settings.axis} stays on: "
                             "switch it off at the controller")
        servo_s = float(device.qSPA(settings.axis, SERVO_UPDATE_TIME_S)[
            settings.axis][SERVO_UPDATE_TIME_S])
        divider = whole_divider(1.0 / servo_s, sample_rate_hz, settings.controller)
        table_samples = int(device.qSPA(settings.axis, RECORD_POINTS)[
            settings.axis][RECORD_POINTS]) // device.qTNR()
        if samples > table_samples:
            raise ValueError(f"{settings.controller} records {table_samples} samples at a time: "
                             "set longest_program_samples to no more, or fewer record tables")
        device.WTR(settings.wave_generator, divider, 0)
        device.RTR(divider)
        device.DRC(POSITION_TABLE, settings.axis, CURRENT_POSITION)
        device.DRC(VOLTAGE_TABLE, settings.output_channel, settings.voltage_record_option)

    def start(self, voltage_v: np.ndarray) -> None:
        """Write the wave table, and start it once; see `WaveformInstrument`."""
        device, settings = self._device, self._settings
        self._samples = len(voltage_v)
        points = self._control(voltage_v).tolist()
        device.WCL(settings.wave_table)
        for first in range(0, len(points), settings.points_per_command):
            part = points[first:first + settings.points_per_command]
            device.WAV_PNT(settings.wave_table, first + 1, len(part), "&" if first else "X", part)
        device.WSL(settings.wave_generator, settings.wave_table)
        device.WGC(settings.wave_generator, 1)
        device.WGO(settings.wave_generator, START)

    def running(self) -> bool:
        """Return whether the generator runs, or points are still missing."""
        generator = self._settings.wave_generator
        if self._device.IsGeneratorRunning(generator)[generator]:
            return True
        return self._device.qDRL(POSITION_TABLE)[POSITION_TABLE] < self._samples

    def recorded(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Read both record tables; see `WaveformInstrument`."""
        device = self._device
        device.qDRR([POSITION_TABLE, VOLTAGE_TABLE], 1, samples)
        while device.bufstate is not True:
            time.sleep(READ_POLL_S)
        position, voltage_v = np.asarray(device.bufdata, dtype=float)
        return voltage_v[:samples], (
            self._settings.displacement_um_per_unit * position[:samples])

    def displacement_um(self) -> float:
        """Read the position once (um)."""
        position = self._device.qPOS(self._settings.axis)[self._settings.axis]
        return float(self._settings.displacement_um_per_unit * position)

    def held_v(self) -> float:
        """Read the voltage of the output channel (V)."""
        channel = self._settings.output_channel
        return float(self._device.qVOL(channel)[channel])

    def hold(self, voltage_v: float) -> None:
        """Command a control value (SVA)."""
        self._device.SVA(self._settings.axis, self._control(voltage_v))

    def halt(self) -> None:
        """Stop the wave generator."""
        self._device.WGO(self._settings.wave_generator, STOP)

    def close(self) -> None:
        """Disconnect from the controller."""
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def _control(self, voltage_v: Volts) -> Volts:
        return self._settings.control_per_v * voltage_v + self._settings.control_at_0_v

    def _connected(self) -> Any:
        settings, library = self._settings, self._library
        if settings.interface == "tcpip":  # without the vendor's shared library
            return library.GCSDevice(gateway=library.Socket(settings.address))
        device = library.GCSDevice(settings.controller)
        device.ConnectUSB(settings.address)
        return device


def create(settings: BackendSettings) -> StoredWaveformStage:
    """Create the backend from its settings; the entry point ``pi_gcs``.

    Raises
    ------
    ValueError
        If the file is missing or invalid, or the library is missing.
    """
    told = settings_of("pi_gcs", PiSettings, settings)
    return StoredWaveformStage(
        PiController(told), settings, told.longest_program_samples, told.transfer_s)
