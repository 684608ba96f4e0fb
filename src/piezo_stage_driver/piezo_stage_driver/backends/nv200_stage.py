# SPDX-License-Identifier: BSD-3-Clause
"""A stage behind an NV200 of piezosystem jena, by the package ``nv200``.

Its waveform generator plays up to 1024 values, and its recorder stores up to 6144, both on a clock
of 20 kHz divided by a whole number. The generator starts the recorder. The loop is open, so the
values are voltages.
"""

import asyncio
import importlib
import threading
from collections.abc import Coroutine
from types import SimpleNamespace
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import model_validator

from piezo_common.schema import Document, Positive, entry, violation
from piezo_stage_driver.backends.registry import BackendSettings
from piezo_stage_driver.backends.stored_waveforms import (
    StoredWaveformStage,
    settings_of,
    whole_divider,
)

CLOCK_HZ = 20000.0
GENERATOR_SAMPLES = 1024
POSITION_CHANNEL, VOLTAGE_CHANNEL = 0, 1

Answer = TypeVar("Answer")


class Nv200Settings(Document):
    """Settings of an NV200."""

    TITLE: ClassVar[str] = "settings of the backend nv200"
    SYNTAX: ClassVar[str] = "yaml"
    RENEW: ClassVar[str] = "add it"

    interface: Literal["serial", "telnet"] = entry("How the device is connected.")
    address: str = entry("Serial port, such as /dev/ttyUSB0; with telnet the IP address.")
    longest_program_samples: int = entry(
        "Longest waveform with its ramps; the stage is ahead by so much.",
        at_least=1, at_most=GENERATOR_SAMPLES)
    transfer_s: Positive = entry("What storing a waveform and reading its record may take.",
                                 unit="s")

    @model_validator(mode="before")
    @classmethod
    def _refuse_axes(cls, content: Any) -> Any:
        if isinstance(content, dict) and "axes" in content:
            raise violation(
                "is not possible: an NV200 drives one axis, and shares its clock with no other",
                "use a backend that drives all axes on one clock, such as pi_gcs", "axes")
        return content


def load_library() -> SimpleNamespace:
    """Return the parts of the package ``nv200`` that are needed; ValueError if it is missing."""
    try:
        device, types, connection, generator, recorder = (
            importlib.import_module(f"nv200.{name}")
            for name in ("nv200_device", "shared_types", "connection_utils", "waveform_generator",
                         "data_recorder"))
    except ImportError as error:
        raise ValueError(f"the backend nv200 needs the Python package nv200 ({error}): install it "
                         "by pip into a Python of 3.12 or later") from None
    return SimpleNamespace(
        connect=lambda interface, address: connection.connect_to_single_device(
            device.NV200Device, types.TransportType[interface.upper()], address),
        Generator=generator.WaveformGenerator, Unit=generator.WaveformUnit,
        Recorder=recorder.DataRecorder, Source=recorder.DataRecorderSource,
        AutoStart=recorder.RecorderAutoStartMode, Error=types.DeviceError)


class Nv200:
    """An NV200 as a `WaveformInstrument`.

    Its library is asynchronous: a thread runs it, and every call waits for its result.
    """

    name = "nv200"
    axes: tuple[str, ...] = ()
    failures: tuple[type[Exception], ...]

    def __init__(self, settings: Nv200Settings, library: SimpleNamespace | None = None):
        self._settings = settings
        self._library = library or load_library()
        self.failures = (self._library.Error, OSError, RuntimeError, asyncio.TimeoutError)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._device: Any = None

    def open(self, sample_rate_hz: float, samples: int) -> None:
        """Connect, open the loop, and set the rates; see `WaveformInstrument`."""
        self._divider = whole_divider(CLOCK_HZ, sample_rate_hz, "an NV200")
        self._sample_period_ms = 1e3 / sample_rate_hz
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, name="nv200", daemon=True).start()
        library = self._library
        self._device = self._wait(
            library.connect(self._settings.interface, self._settings.address))
        self._wait(self._device.pid.set_closed_loop(False))
        if self._wait(self._device.pid.is_closed_loop()):
            raise ValueError("the NV200 stays in closed loop: open it at the device")
        self._range_v = self._wait(self._device.get_voltage_range())
        self._generator = library.Generator(self._device)
        self._recorder = library.Recorder(self._device)
        self._wait(self._prepare_recorder())

    def start(self, voltage_v: np.ndarray) -> None:
        """Write the waveform, and start it once; see `WaveformInstrument`."""
        lowest_v, highest_v = self._range_v
        if voltage_v.min() < lowest_v or voltage_v.max() > highest_v:
            raise RuntimeError(
                f"it reaches {lowest_v:g} to {highest_v:g} V, the waveform "
                f"{voltage_v.min():g} to {voltage_v.max():g} V")
        self._wait(self._started(voltage_v))

    def running(self) -> bool:
        """Return whether the generator or the recorder runs."""
        return bool(self._wait(self._generator.is_running())
                    or self._wait(self._recorder.is_recording()))

    def recorded(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Read both channels of the recorder; see `WaveformInstrument`."""
        position, voltage = (
            np.array([self._wait(self._recorder.read_recorded_data_of_channel(channel)).values]).T
            for channel in (POSITION_CHANNEL, VOLTAGE_CHANNEL))
        if min(len(position), len(voltage)) < samples:
            raise RuntimeError(f"it recorded {min(len(position), len(voltage))} of {samples} "
                               "samples")
        return voltage[:samples], position[:samples]

    def displacement_um(self) -> np.ndarray:
        """Read the position once (um)."""
        return np.array([float(self._wait(self._device.get_current_position()))])

    def held_v(self) -> np.ndarray:
        """Measure the voltage once (V) with the recorder, as the device has no other way."""
        value = float(self._wait(
            self._recorder.read_single_value_from(self._library.Source.PIEZO_VOLTAGE)))
        self._wait(self._prepare_recorder())
        return np.array([value])

    def hold(self, voltage_v: np.ndarray) -> None:
        """Set a voltage by a single command (V)."""
        self._wait(self._device.move_to_voltage(float(voltage_v[0])))

    def halt(self) -> None:
        """Stop the waveform generator."""
        self._wait(self._generator.stop())

    def close(self) -> None:
        """Disconnect, and end the thread."""
        device, self._device = self._device, None
        try:
            if device is not None:
                self._wait(device.close())
        finally:
            loop, self._loop = self._loop, None
            if loop is not None:
                loop.call_soon_threadsafe(loop.stop)

    async def _prepare_recorder(self) -> None:
        library, recorder = self._library, self._recorder
        await recorder.set_data_source(POSITION_CHANNEL, library.Source.PIEZO_POSITION)
        await recorder.set_data_source(VOLTAGE_CHANNEL, library.Source.PIEZO_VOLTAGE)
        await recorder.set_autostart_mode(library.AutoStart.START_ON_WAVEFORM_GEN_RUN)
        await recorder.set_recorder_stride(self._divider)

    async def _started(self, voltage_v: np.ndarray) -> None:
        await self._recorder.set_sample_buffer_size(len(voltage_v))
        waveform = self._library.Generator.WaveformData(
            voltage_v[:, 0].tolist(), self._sample_period_ms)
        await self._generator.set_waveform(waveform, self._library.Unit.VOLTAGE)
        await self._generator.start(cycles=1)

    def _wait(self, coroutine: Coroutine[Any, Any, Answer]) -> Answer:
        assert self._loop is not None  # it is open
        future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        try:
            return future.result(self._settings.transfer_s)
        except TimeoutError:
            future.cancel()
            raise RuntimeError(f"it has not answered for {self._settings.transfer_s:g} s") from None


def create(settings: BackendSettings) -> StoredWaveformStage:
    """Create the backend from its settings; the entry point ``nv200``.

    Raises ValueError if the file is missing or invalid, or the library is missing.
    """
    own = settings_of("nv200", Nv200Settings, Nv200Settings, settings)
    return StoredWaveformStage(
        Nv200(own), settings, own.longest_program_samples, own.transfer_s)
