# SPDX-License-Identifier: BSD-3-Clause
"""A stage of one or several axes behind a National Instruments card, by the package ``nidaqmx``.

Output and input use the input's sample clock. The card does not regenerate the output: the stage
node repeats a periodic feedforward itself and adds the feedback of every tick. The sum is written
`lead_ticks` ahead of the clock. If the computer is later than that, the card stops with its last
voltage, and the amplifier is brought to rest by single writes.

There is no ``emergency_rest``. Each call of the driver is limited to `TIMEOUT_S`, so that a hanging
card becomes a fault by itself. A second thread would have to take the output from a task that
another thread waits for, and this could not be tested on a device.
"""

import importlib
import time
from collections import deque
from types import SimpleNamespace
from typing import Any

import numpy as np

from piezo_stage_driver.backends.backend import BackendFault
from piezo_stage_driver.backends.calibration import (
    AxesCalibration,
    Calibration,
    load_calibration,
)
from piezo_stage_driver.backends.registry import BackendSettings

# The input is read every tick; the card buffers this much before samples are overwritten.
INPUT_BUFFER_S = 1.0
TIMEOUT_S = 1.0
RATE_TOLERANCE = 1e-6
SOFTWARE_STEP_S = 1e-3
# Error codes of NI-DAQmx.
UNDERFLOWS = (-200290, -200621, -200016, -200018)
MEANINGS = {
    **dict.fromkeys(UNDERFLOWS, "the output ran out of samples: the computer was late by more "
                                "than lead_ticks"),
    -200292: "the output took no more samples: its clock does not run",
    -200279: "measured samples were overwritten before they were read: the computer was late",
    -200222: "measured samples were overwritten before they were read: the computer was late",
    -200361: "measured samples were lost in the card: the computer was late",
    -200284: "the card sent no samples: its clock does not run",
}


def load_driver() -> SimpleNamespace:
    """Return the parts of the package ``nidaqmx`` that are needed; ValueError if it is missing."""
    try:
        nidaqmx = importlib.import_module("nidaqmx")
        constants, errors, readers, writers = (
            importlib.import_module(f"nidaqmx.{name}")
            for name in ("constants", "errors", "stream_readers", "stream_writers"))
    except ImportError as error:
        raise ValueError(f"the backend nidaqmx needs the Python package nidaqmx ({error}): "
                         "install it by pip, and the driver NI-DAQmx from ni.com") from None
    return SimpleNamespace(
        Task=nidaqmx.Task, constants=constants, Error=errors.Error, DaqError=errors.DaqError,
        Reader=readers.AnalogSingleChannelReader, Writer=writers.AnalogSingleChannelWriter,
        AxesReader=readers.AnalogMultiChannelReader, AxesWriter=writers.AnalogMultiChannelWriter,
        LinesWriter=writers.DigitalSingleChannelWriter)


class NidaqmxStage:
    """Drive the amplifiers and read the sensors of one axis or several through one card.

    All axes are channels of the same two tasks, so they share one sample clock. Raises ValueError
    if the driver is missing, or the card cannot reach the voltages.
    """

    name = "nidaqmx"

    def __init__(self, calibration: Calibration | AxesCalibration, settings: BackendSettings,
                 driver: SimpleNamespace | None = None):
        self._lead_ticks, self._settings = calibration.lead_ticks, settings
        self._driver = driver or load_driver()
        self.sample_rate_hz = settings.sample_rate_hz
        self.lead_samples = calibration.lead_ticks * settings.samples_per_tick
        self.axes = tuple(filter(None, calibration.by_axis))
        self._mark_lines, self._marks = calibration.mark_lines, np.empty(0, np.uint8)
        self._channels = list(calibration.by_axis.values())
        own = [settings.of_axis(axis) for axis in calibration.by_axis]
        for axis, channel, limits in zip(calibration.by_axis, self._channels, own, strict=True):
            lowest_v, highest_v = channel.voltage_range_v
            if not lowest_v <= limits.minimum_voltage_v < limits.maximum_voltage_v <= highest_v:
                raise ValueError(
                    f"{axis and f'{axis}: '}the card reaches {lowest_v:g} to {highest_v:g} V at "
                    "the stage: set minimum_voltage_v and maximum_voltage_v within, or mend the "
                    "calibration")
        # Numbers for one axis, arrays for several.
        self._rest_v, self._ramp_v_per_s = (
            np.array([getattr(limits, name) for limits in own]) if self.axes
            else getattr(settings, name) for name in ("rest_voltage_v", "ramp_rate_v_per_s"))
        self._tasks: list[Any] = []
        self._ahead: deque[np.ndarray] = deque()

    def open(self) -> None:
        """Start both tasks with the amplifier at rest; see ``StageBackend.open``."""
        try:
            self._start()
        except self._driver.Error as error:
            self._end_tasks()
            raise ValueError(f"the card cannot be started: {_first_line(error)}") from None
        except ValueError:
            self._end_tasks()
            raise

    def put_out_marks(self, marks: np.ndarray) -> None:
        """Put out marks with the voltages that are written next."""
        self._marks = marks

    def exchange(self, voltage_v: np.ndarray) -> np.ndarray:
        """Write the voltages for `lead_samples` later, and read the present measurement."""
        readings_v = np.empty(voltage_v.T.shape)
        try:
            self._write(voltage_v)
            self._reader.read_many_sample(readings_v, len(voltage_v), timeout=TIMEOUT_S)
        except self._driver.Error as error:
            at_rest = self._return_to_rest(self._held_v(error))
            raise BackendFault(self._meaning(error), at_rest) from None
        self._ahead.popleft()
        if not self.axes:
            return self._channels[0].displacement_um(readings_v)
        return np.column_stack([channel.displacement_um(of_axis_v) for channel, of_axis_v in zip(
            self._channels, readings_v, strict=True)])

    def close(self) -> None:
        """Stop both tasks; the card holds its last voltage."""
        self._end_tasks()

    def _start(self) -> None:
        driver = self._driver
        continuous = driver.constants.AcquisitionType.CONTINUOUS
        buffer_samples = round(INPUT_BUFFER_S * self.sample_rate_hz)
        measuring, playing = self._task("input"), self._task("output")
        for channel in self._channels:
            measuring.ai_channels.add_ai_voltage_chan(
                channel.input_channel,
                terminal_config=driver.constants.TerminalConfiguration[
                    channel.terminal_configuration],
                min_val=channel.input_minimum_v, max_val=channel.input_maximum_v)
        self._add_outputs(playing)
        measuring.timing.cfg_samp_clk_timing(
            self.sample_rate_hz, sample_mode=continuous, samps_per_chan=buffer_samples)
        actual_hz = measuring.timing.samp_clk_rate
        if abs(actual_hz - self.sample_rate_hz) > RATE_TOLERANCE * self.sample_rate_hz:
            raise ValueError(f"the card's clock goes at {actual_hz:g} Hz, not at "
                             f"{self.sample_rate_hz:g} Hz: set sample_rate_hz to it")
        self._follow_input(playing)
        reader, writer = ((driver.AxesReader, driver.AxesWriter) if self.axes
                          else (driver.Reader, driver.Writer))
        self._reader = reader(measuring.in_stream)
        self._writer = writer(playing.out_stream, auto_start=False)
        if self._mark_lines:
            lines = self._task("marks")
            # One channel of all lines, so that a byte is a sample of all of them.
            lines.do_channels.add_do_chan(
                self._mark_lines, line_grouping=driver.constants.LineGrouping.CHAN_FOR_ALL_LINES)
            self._follow_input(lines)
            self._lines_writer = driver.LinesWriter(lines.out_stream, auto_start=False)
        self._ahead.clear()
        for _ in range(self._lead_ticks):
            self._write(np.full(
                (self._settings.samples_per_tick, *np.shape(self._rest_v)), self._rest_v))
        # The outputs wait for the clock, which begins with the input.
        for task in reversed(self._tasks):
            task.start()

    def _follow_input(self, task: Any) -> None:
        """Let an output use the clock of the input."""
        constants = self._driver.constants
        task.timing.cfg_samp_clk_timing(
            self.sample_rate_hz, source=f"/{self._channels[0].device}/ai/SampleClock",
            sample_mode=constants.AcquisitionType.CONTINUOUS,
            samps_per_chan=2 * self.lead_samples)
        task.out_stream.regen_mode = constants.RegenerationMode.DONT_ALLOW_REGENERATION

    def _task(self, name: str) -> Any:
        task = self._driver.Task(f"piezo_stage_{name}")
        self._tasks.append(task)
        return task

    def _add_outputs(self, task: Any) -> None:
        for channel in self._channels:
            task.ao_channels.add_ao_voltage_chan(
                channel.output_channel, min_val=channel.output_minimum_v,
                max_val=channel.output_maximum_v)

    def _write(self, voltage_v: np.ndarray) -> None:
        self._writer.write_many_sample(self._card_v(voltage_v), timeout=TIMEOUT_S)
        if self._mark_lines:
            marks = np.zeros(len(voltage_v), np.uint8)
            marks[:len(self._marks)] = self._marks
            self._lines_writer.write_many_sample_port_byte(marks, timeout=TIMEOUT_S)
        self._marks = np.empty(0, np.uint8)
        self._ahead.append(voltage_v)

    def _card_v(self, voltage_v: np.ndarray) -> np.ndarray:
        """Return samples in volts at the card, shape (n,) or (axes, n)."""
        if not self.axes:
            return self._channels[0].card_v(voltage_v)
        return np.array([channel.card_v(of_axis_v) for channel, of_axis_v in zip(
            self._channels, voltage_v.T, strict=True)])

    def _held_v(self, error: Exception) -> np.ndarray:
        """Return the voltage that the card holds after a fault; the last one after an underflow."""
        ran_out = getattr(error, "error_code", None) in UNDERFLOWS
        return np.asarray(self._ahead[-1 if ran_out else 0][-1])

    def _return_to_rest(self, start_v: np.ndarray) -> bool:
        """Ramp to rest by single writes in software time; return whether the card accepted them."""
        self._end_tasks()
        step_v = self._ramp_v_per_s * SOFTWARE_STEP_S
        steps = max(1, int(np.ceil(np.max(np.abs(start_v - self._rest_v) / step_v))))
        try:
            task = self._task("rest")
            self._add_outputs(task)
            for voltage_v in np.linspace(start_v, self._rest_v, steps + 1):
                # A number for one channel, a list with one number per channel for several.
                task.write(self._card_v(voltage_v).tolist(), auto_start=True)
                time.sleep(SOFTWARE_STEP_S)
            return True
        except self._driver.Error:
            return False  # the card does not respond: nothing more can be done from here
        finally:
            self._end_tasks()

    def _end_tasks(self) -> None:
        while self._tasks:
            try:
                self._tasks.pop().close()
            except self._driver.Error:
                pass  # of a task that a fault has ended already

    def _meaning(self, error: Exception) -> str:
        code = getattr(error, "error_code", 0)
        return f"the card failed: {MEANINGS.get(code) or _first_line(error)}" + (
            f" (NI-DAQmx {code})" if code else "")


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n")[0]


def create(settings: BackendSettings) -> "NidaqmxStage":
    """Create the backend from its calibration file; the entry point ``nidaqmx``.

    Raises ValueError if the file is missing or invalid, or the driver is missing.
    """
    if not settings.file:
        raise ValueError("the backend nidaqmx needs a calibration: set the parameter backend_file")
    return NidaqmxStage(load_calibration(settings.file), settings)
