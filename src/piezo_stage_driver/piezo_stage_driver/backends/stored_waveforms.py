# SPDX-License-Identifier: BSD-3-Clause
"""Drive a stage through an instrument that plays and records stored waveforms.

Controllers of piezo stages have no clock that a computer could follow sample by sample. They have a
memory for a waveform, and a recorder on the same clock. The stage node plays ahead of what it
publishes by the length of that memory: every waveform is complete, from its approach to its return
to rest, when its first sample is due, and the instrument plays it as a whole. Decisions during a
waveform therefore cannot act, and commands that need them are refused: see
`longest_program_samples`.
"""

import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from piezo_common.schema import SchemaError
from piezo_stage_driver.backends.axes_file import One, Several, load_axes_file
from piezo_stage_driver.backends.backend import BackendFault
from piezo_stage_driver.backends.registry import BackendSettings

POLL_S = 0.01
IDLE_READING_S = 0.05
REST_STEP_S = 0.01
FASTEST_TICK_S = 1e-3
"""Shortest tick at which the subscribers of a paced stage lose no samples (s)."""
# Part of the swing; the instrument rounds, and its record of the voltage may lag by a sample.
VOLTAGE_TOLERANCE = 0.05


class WaveformInstrument(Protocol):
    """Interface of an instrument with a waveform memory and a recorder.

    Attributes
    ----------
    name : str
        Name of the backend.
    axes : tuple of str
        Names of the axes if there are several. All play on one clock, begin in the same sample,
        and stop together. Arrays have a column for each; a single axis has one column.
    failures : tuple of type
        Exceptions that its library raises if the instrument fails.
    """

    name: str
    axes: tuple[str, ...]
    failures: tuple[type[Exception], ...]

    def open(self, sample_rate_hz: float, samples: int) -> None:
        """Connect, with the servo off, and prepare for waveforms of this length and rate.

        Raises ValueError, which says what the instrument supports, if it does not support them.
        """

    def start(self, voltage_v: np.ndarray) -> None:
        """Store a waveform, shape (n, axes), and start it together with the recorder."""

    def running(self) -> bool:
        """Return whether the waveform is still played or recorded."""

    def recorded(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the recorded voltage (V) and displacement (um), shape (samples, axes) each."""

    def displacement_um(self) -> np.ndarray:
        """Read the sensors once (um), shape (axes,)."""

    def held_v(self) -> np.ndarray:
        """Return the present output voltages of the instrument (V), shape (axes,)."""

    def hold(self, voltage_v: np.ndarray) -> None:
        """Set the voltages of all axes, shape (axes,), by a single command (V)."""

    def halt(self) -> None:
        """End a waveform that plays; the voltage may stay at its present value."""

    def close(self) -> None:
        """Disconnect from the instrument."""


class StoredWaveformStage:
    """Play whole waveforms through an instrument; see `StageBackend`.

    The length of the longest waveform, including its ramps, is rounded down to whole ticks; to
    store a waveform and to read its record takes `transfer_s` at most. The stage node refuses
    longer waveforms, and everything except a waveform that ends at rest. Raises ValueError if the
    longest waveform is shorter than a tick, or longer than the node's time limit.
    """

    _planned_v: np.ndarray
    _recorded_um: np.ndarray

    def __init__(self, instrument: WaveformInstrument, settings: BackendSettings,
                 longest_program_samples: int, transfer_s: float):
        ticks = longest_program_samples // settings.samples_per_tick
        if ticks < 1:
            raise ValueError(f"{longest_program_samples} samples are less than a tick of "
                             f"{settings.samples_per_tick}: set samples_per_tick lower")
        self.name, self.axes = instrument.name, instrument.axes
        self.sample_rate_hz = settings.sample_rate_hz
        self.lead_samples = self.longest_program_samples = ticks * settings.samples_per_tick
        self._instrument = instrument
        own = [settings.of_axis(axis) for axis in self.axes or ("",)]
        self._rest_v = np.array([limits.rest_voltage_v for limits in own])
        self._ramp_v_per_s = np.array([limits.ramp_rate_v_per_s for limits in own])
        self._wait_s = self.lead_samples / settings.sample_rate_hz + transfer_s
        if self._wait_s > settings.exchange_timeout_s:
            raise ValueError(
                f"a waveform of {self.lead_samples} samples takes up to {self._wait_s:g} s with "
                f"its transfer, the node waits {settings.exchange_timeout_s:g} s: set "
                "exchange_timeout_s higher, or longest_program_samples lower")
        self._stopped: Callable[[], bool] = lambda: False
        self._forget()

    def watch_stop(self, stopped: Callable[[], bool]) -> None:
        """Set a function that returns whether the stage was stopped; a waveform is then ended."""
        self._stopped = stopped

    def open(self) -> None:
        """Connect with the servo off and the amplifier at rest; see ``StageBackend.open``."""
        self._forget()
        try:
            self._instrument.open(self.sample_rate_hz, self.lead_samples)
            self._ramp_to_rest()
        except self._instrument.failures as error:
            self.close()
            raise ValueError(f"{self.name} cannot be opened: {_first_line(error)}") from None
        except ValueError:
            self.close()
            raise

    def exchange(self, voltage_v: np.ndarray) -> np.ndarray:
        """Store the voltages for `lead_samples` later, and return the present displacements."""
        self._planned_v = np.concatenate([
            self._planned_v, voltage_v.reshape(len(voltage_v), -1)])
        due_v, self._planned_v = np.split(self._planned_v, [len(voltage_v)])
        # There is no need to wait for the clock while a waveform is only stored or returned.
        tick_s = len(due_v) / self.sample_rate_hz
        idle = self._at_rest(due_v) and self._at_rest(self._planned_v)
        time.sleep(tick_s if idle else min(tick_s, FASTEST_TICK_S))
        if not len(self._recorded_um):
            if self._at_rest(due_v):
                return self._idle(len(due_v)).reshape(voltage_v.shape)
            program_v = np.concatenate([due_v, self._planned_v])
            self._recorded_um = self._play(program_v[:self._end(program_v)])
        displacement_um, self._recorded_um = np.split(self._recorded_um, [len(due_v)])
        if len(displacement_um) < len(due_v):
            missing = len(due_v) - len(displacement_um)
            displacement_um = np.pad(displacement_um, ((0, missing), (0, 0)), mode="edge")
        return displacement_um.reshape(voltage_v.shape)

    def close(self) -> None:
        """Disconnect; the instrument holds its last voltage."""
        try:
            self._instrument.close()
        except self._instrument.failures:
            pass  # it is disconnected already

    def _forget(self) -> None:
        self._planned_v = np.tile(self._rest_v, (self.lead_samples, 1))
        self._recorded_um = np.empty((0, len(self._rest_v)))
        self._reading_um, self._read_at_s = np.zeros(len(self._rest_v)), -np.inf

    def _at_rest(self, voltage_v: np.ndarray) -> bool:
        return bool((voltage_v == self._rest_v).all())

    def _end(self, program_v: np.ndarray) -> int:
        """Return the length of a program up to its last sample away from rest, plus one at rest."""
        last = int(np.flatnonzero((program_v != self._rest_v).any(axis=1))[-1])
        if last + 1 >= len(program_v):
            raise BackendFault(f"{self.name} was given a waveform that does not end at rest "
                               f"within {self.lead_samples} samples: none of it was played")
        return last + 2

    def _idle(self, samples: int) -> np.ndarray:
        """Return the displacements at rest; the sensors are read from time to time."""
        if time.monotonic() - self._read_at_s >= IDLE_READING_S:
            try:
                self._reading_um = self._instrument.displacement_um()
            except self._instrument.failures as error:
                raise self._fault(error) from None
            self._read_at_s = time.monotonic()
        return np.tile(self._reading_um, (samples, 1))

    def _play(self, program_v: np.ndarray) -> np.ndarray:
        """Play a program, and return the displacements that were recorded with it."""
        if self._stopped():
            raise BackendFault(f"{self.name}: the stage was stopped before the waveform began")
        deadline_s = time.monotonic() + self._wait_s
        try:
            self._instrument.start(program_v)
            while self._instrument.running():
                if self._stopped():
                    raise self._fault("the stage was stopped, and the waveform ended early")
                if time.monotonic() > deadline_s:
                    raise self._fault(f"a waveform of {len(program_v)} samples has not ended "
                                      f"after {self._wait_s:g} s")
                time.sleep(POLL_S)
            voltage_v, displacement_um = self._instrument.recorded(len(program_v))
        except self._instrument.failures as error:
            raise self._fault(error) from None
        self._check_played(program_v, voltage_v)
        return displacement_um

    def _check_played(self, program_v: np.ndarray, voltage_v: np.ndarray) -> None:
        """Raise if the recorded voltage of an axis is not that of the program."""
        swing_v = np.ptp(program_v, axis=0)
        # An axis that rests has no swing of its own, and may see some of the others'.
        tolerance_v = VOLTAGE_TOLERANCE * np.maximum(swing_v, VOLTAGE_TOLERANCE * swing_v.max())
        difference_v = np.sqrt(np.mean((voltage_v - program_v) ** 2, axis=0))
        wrong = np.flatnonzero(~(difference_v <= tolerance_v))
        if wrong.size:
            at = wrong[0]
            raise self._fault(
                f"{self.axes[at] + ': ' if self.axes else ''}its own record of the voltage is "
                f"{difference_v[at]:.3g} V RMS off what it was given ({swing_v[at]:.3g} V from end "
                "to end): see that the servo is off, the scales are right, and nothing else "
                "commands it")

    def _fault(self, error: Exception | str) -> BackendFault:
        """Bring the amplifier to rest; return the fault to raise."""
        try:
            self._instrument.halt()
            self._ramp_to_rest()
            at_rest = True
        except self._instrument.failures:
            at_rest = False  # nothing more can be done from here
        return BackendFault(f"{self.name} failed: {_first_line(error)}", at_rest)

    def _ramp_to_rest(self) -> None:
        """Ramp to rest by single commands in software time."""
        rest_v = self._rest_v
        start_v = self._instrument.held_v()
        step_v = self._ramp_v_per_s * REST_STEP_S
        steps = int(np.ceil(np.max(np.abs(start_v - rest_v) / step_v)))
        for voltage_v in np.linspace(start_v, rest_v, steps + 1)[1:]:
            self._instrument.hold(voltage_v)
            time.sleep(REST_STEP_S)
        self._instrument.hold(rest_v)


def settings_of(backend: str, one: type[One], several: type[Several],
                settings: BackendSettings) -> One | Several:
    """Read the settings file of a backend, a document of one axis or of several.

    Raises ValueError if it is missing or invalid.
    """
    if not settings.file:
        raise ValueError(
            f"the backend {backend} needs its settings: set the parameter backend_file")
    try:
        return load_axes_file(one, several, settings.file)
    except SchemaError as error:
        raise ValueError(f"{settings.file}: {error}") from None


def whole_divider(base_rate_hz: float, sample_rate_hz: float, owner: str) -> int:
    """Return the factor by which an instrument divides its clock for a sample rate.

    Raises ValueError, which names the nearest possible rates, if it is not a whole number.
    """
    ratio = base_rate_hz / sample_rate_hz
    divider = max(1, round(ratio))
    if abs(ratio - divider) > 1e-6 * ratio:
        near = sorted({max(1, int(ratio)), int(ratio) + 1})
        rates = " or ".join(f"{base_rate_hz / n:.10g}" for n in near)
        raise ValueError(
            f"{owner} plays {base_rate_hz:g} samples a second divided by a whole number, not "
            f"{sample_rate_hz:g}: set sample_rate_hz to {rates}")
    return divider


def _first_line(error: Exception | str) -> str:
    return (str(error).strip() or repr(error)).split("\n")[0]
