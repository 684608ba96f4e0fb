# SPDX-License-Identifier: BSD-3-Clause
"""Drive a stage through an instrument that plays stored waveforms and records beside them.

Controllers of piezo stages have no clock that a computer could follow sample by sample. They have a
memory for a waveform, and a recorder on the same clock. The stage node plays ahead of what it
publishes by the length of that memory: every waveform is then complete, from its approach to its
return to rest, when its first sample is due, and the instrument plays it in one go. So nothing that
is decided meanwhile can act, and commands that need it are refused: see `longest_program_samples`.
"""

import time
from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np

from piezo_common.schema import Document, SchemaError, load_document
from piezo_stage_driver.backends.backend import BackendFault
from piezo_stage_driver.backends.registry import BackendSettings

POLL_S = 0.01
IDLE_READING_S = 0.05
REST_STEP_S = 0.01
FASTEST_TICK_S = 1e-3
"""What the subscribers of samples take of a paced stage without losing any."""
# Of the swing; the instrument rounds, and its own record of the voltage may lag by a sample.
VOLTAGE_TOLERANCE = 0.05


Settings = TypeVar("Settings", bound=Document)


class WaveformInstrument(Protocol):
    """What an instrument with a waveform memory and a recorder is asked for.

    Attributes
    ----------
    name : str
        Of the backend.
    failures : tuple of type
        What its library raises where the instrument fails.
    """

    name: str
    failures: tuple[type[Exception], ...]

    def open(self, sample_rate_hz: float, samples: int) -> None:
        """Connect, with the servo off; prepare for waveforms of so many samples at this rate.

        Raises
        ------
        ValueError
            If the instrument cannot do that; the text says what it can.
        """

    def start(self, voltage_v: np.ndarray) -> None:
        """Store a waveform, shape (n,), and start it together with the recorder."""

    def running(self) -> bool:
        """Tell whether the waveform still plays, or is still recorded."""

    def recorded(self, samples: int) -> tuple[np.ndarray, np.ndarray]:
        """Return voltage (V) and displacement (um), each of shape (samples,), as recorded."""

    def displacement_um(self) -> float:
        """Read the sensor once."""

    def held_v(self) -> float:
        """Tell the voltage that the instrument puts out now."""

    def hold(self, voltage_v: float) -> None:
        """Put out a voltage by a single command."""

    def halt(self) -> None:
        """End a waveform that plays; the voltage may stay where it is."""

    def close(self) -> None:
        """Disconnect from the instrument."""


class StoredWaveformStage:
    """Play whole waveforms through an instrument; see `StageBackend`.

    Parameters
    ----------
    longest_program_samples : int
        Of the longest waveform with its ramps; rounded down to whole ticks.
    transfer_s : float
        How long it may take to store a waveform and to read its record (s).

    Attributes
    ----------
    longest_program_samples : int
        The stage node refuses what takes more, and everything else than a waveform that ends at
        rest.

    Raises
    ------
    ValueError
        If the longest waveform is shorter than a tick, or longer than the node lets a backend wait.
    """

    _planned_v: np.ndarray
    _recorded_um: np.ndarray

    def __init__(self, instrument: WaveformInstrument, settings: BackendSettings,
                 longest_program_samples: int, transfer_s: float):
        ticks = longest_program_samples // settings.samples_per_tick
        if ticks < 1:
            raise ValueError(f"{longest_program_samples} samples are less than a tick of "
                             f"{settings.samples_per_tick}: set samples_per_tick lower")
        self.name = instrument.name
        self.sample_rate_hz = settings.sample_rate_hz
        self.lead_samples = self.longest_program_samples = ticks * settings.samples_per_tick
        self._instrument, self._settings = instrument, settings
        self._wait_s = self.lead_samples / settings.sample_rate_hz + transfer_s
        if self._wait_s > settings.exchange_timeout_s:
            raise ValueError(
                f"a waveform of {self.lead_samples} samples takes up to {self._wait_s:g} s with "
                f"its transfer, the node waits {settings.exchange_timeout_s:g} s: set "
                "exchange_timeout_s higher, or longest_program_samples lower")
        self._stopped: Callable[[], bool] = lambda: False
        self._forget()

    def watch_stop(self, stopped: Callable[[], bool]) -> None:
        """Take what tells whether the stage was stopped; a waveform that plays is then ended."""
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
        """Take what plays `lead_samples` later, return what belongs to what plays now."""
        self._planned_v = np.concatenate([self._planned_v, voltage_v])
        due_v, self._planned_v = np.split(self._planned_v, [len(voltage_v)])
        # Nothing has to wait for the clock while a waveform is only taken, or handed out.
        tick_s = len(due_v) / self.sample_rate_hz
        idle = self._at_rest(due_v) and self._at_rest(self._planned_v)
        time.sleep(tick_s if idle else min(tick_s, FASTEST_TICK_S))
        if not len(self._recorded_um):
            if self._at_rest(due_v):
                return self._idle(len(due_v))
            program_v = np.concatenate([due_v, self._planned_v])
            self._recorded_um = self._play(program_v[:self._end(program_v)])
        displacement_um, self._recorded_um = np.split(self._recorded_um, [len(due_v)])
        if len(displacement_um) < len(due_v):
            displacement_um = np.pad(displacement_um, (0, len(due_v) - len(displacement_um)),
                                     mode="edge")
        return displacement_um

    def close(self) -> None:
        """Disconnect; the instrument holds its last voltage."""
        try:
            self._instrument.close()
        except self._instrument.failures:
            pass  # it is gone already

    def _forget(self) -> None:
        self._planned_v = np.full(self.lead_samples, self._settings.rest_voltage_v)
        self._recorded_um = np.empty(0)
        self._reading_um, self._read_at_s = 0.0, -np.inf

    def _at_rest(self, voltage_v: np.ndarray) -> bool:
        return bool((voltage_v == self._settings.rest_voltage_v).all())

    def _end(self, program_v: np.ndarray) -> int:
        """Return the length of a program up to its last sample away from rest and one at rest."""
        last = int(np.flatnonzero(program_v != self._settings.rest_voltage_v)[-1])
        if last + 1 >= len(program_v):
            raise BackendFault(f"{self.name} was given a waveform that does not end at rest "
                               f"within {self.lead_samples} samples: none of it was played")
        return last + 2

    def _idle(self, samples: int) -> np.ndarray:
        """Read the sensor now and then while nothing plays."""
        if time.monotonic() - self._read_at_s >= IDLE_READING_S:
            try:
                self._reading_um = self._instrument.displacement_um()
            except self._instrument.failures as error:
                raise self._fault(error) from None
            self._read_at_s = time.monotonic()
        return np.full(samples, self._reading_um)

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
        """Refuse a record whose voltage is not the one that was to be played."""
        difference_v = float(np.sqrt(np.mean((voltage_v - program_v) ** 2)))
        if difference_v > VOLTAGE_TOLERANCE * np.ptp(program_v):
            raise self._fault(
                f"its own record of the voltage is {difference_v:.3g} V RMS off what it was given "
                f"({np.ptp(program_v):.3g} V from end to end): see that the servo is off, the "
                "scales are right, and nothing else commands it")

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
        """Go to rest by single commands in software time."""
        rest_v = self._settings.rest_voltage_v
        start_v = self._instrument.held_v()
        step_v = self._settings.ramp_rate_v_per_s * REST_STEP_S
        steps = int(np.ceil(abs(start_v - rest_v) / step_v))
        for voltage_v in np.linspace(start_v, rest_v, steps + 1)[1:]:
            self._instrument.hold(float(voltage_v))
            time.sleep(REST_STEP_S)
        self._instrument.hold(rest_v)


def settings_of(backend: str, kind: type[Settings], settings: BackendSettings) -> Settings:
    """Read the settings' file of a backend.

    Parameters
    ----------
    backend : str
        Its name.
    kind : type
        Of the document.

    Raises
    ------
    ValueError
        If the file is missing or wrong.
    """
    if not settings.file:
        raise ValueError(
            f"the backend {backend} needs its settings: set the parameter backend_file")
    try:
        return load_document(kind, settings.file)
    except SchemaError as error:
        raise ValueError(f"{settings.file}: {error}") from None


def whole_divider(base_rate_hz: float, sample_rate_hz: float, owner: str) -> int:
    """Return by what an instrument divides its clock for a sample rate.

    Raises
    ------
    ValueError
        If that is no whole number; the text names the nearest rates that are.
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
