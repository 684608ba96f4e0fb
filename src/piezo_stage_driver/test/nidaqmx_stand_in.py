# SPDX-License-Identifier: BSD-3-Clause
"""A card in place of NI's: what the documentation of NI-DAQmx says of it, and a stage behind it.

Time passes only while a task waits for samples, or by `Card.be_late`.
"""

from types import SimpleNamespace

import numpy as np


class Error(Exception):
    """As ``nidaqmx.errors.Error``."""


class DaqError(Error):
    """As ``nidaqmx.errors.DaqError``."""

    def __init__(self, message, error_code):
        self.error_code = error_code
        super().__init__(f"{message}\n\nTask Name: piezo\n\nStatus Code: {error_code}")


class Card:
    """The hardware under all tasks.

    Attributes
    ----------
    held_v : float or ndarray
        At the output, of each channel where there are several.
    played_v : list
        Every sample that the clock took.
    single_v : list
        Every single write.
    put_out : list
        Byte at the digital lines with every sample that the clock took.
    """

    def __init__(self, clock_hz=40000.0, um_per_v=1.0, channels=1):
        self.clock_hz, self.um_per_v = clock_hz, um_per_v
        self.held_v = 0.0 if channels == 1 else np.zeros(channels)
        self.played_v, self.single_v = [], []
        self.waiting_v, self.measured_v = [], []
        self.waiting_marks, self.put_out = [], []
        self.output_runs = self.input_runs = self.lines_run = False
        self.fault = self.input_buffer = None
        self.open_tasks = 0

    def be_late(self, samples):
        """Let the clock go on while nobody reads or writes."""
        for _ in range(samples):
            # The sensor of a stage of gain 1 um/V behind an amplifier of gain 10, 10 um/V.
            self.measured_v.append(self.held_v * self.um_per_v)
            if self.output_runs and not self.fault:
                if self.waiting_v:
                    self.held_v = self.waiting_v.pop(0)
                    self.played_v.append(self.held_v)
                    if self.lines_run:
                        self.put_out.append(self.waiting_marks.pop(0))
                else:
                    self.fault = DaqError("The generation has stopped to prevent the "
                                          "regeneration of old samples.", -200290)
        if len(self.measured_v) > self.input_buffer:
            self.fault = self.fault or DaqError(
                "The application is not able to keep up with the hardware acquisition.", -200279)

    def driver(self):
        """Tell what `nidaqmx_stage.load_driver` would return."""
        card = self

        class BoundTask(Task):
            def __init__(self, name):
                super().__init__(card, name)

        return SimpleNamespace(
            Task=BoundTask, Reader=Reader, Writer=Writer, Error=Error, DaqError=DaqError,
            AxesReader=AxesReader, AxesWriter=AxesWriter, LinesWriter=LinesWriter,
            constants=SimpleNamespace(
                AcquisitionType=SimpleNamespace(CONTINUOUS="continuous"),
                LineGrouping=SimpleNamespace(CHAN_FOR_ALL_LINES="one channel"),
                RegenerationMode=SimpleNamespace(DONT_ALLOW_REGENERATION="none"),
                TerminalConfiguration={"DIFF": "differential"}))


class Task:
    """As ``nidaqmx.Task``: the part that a stage needs."""

    def __init__(self, card, name):
        self.card, self.name = card, name
        self.kind = self.source = None
        self.channels, self.ranges_v = [], []
        card.open_tasks += 1
        self.ai_channels = SimpleNamespace(add_ai_voltage_chan=self._add_input)
        self.ao_channels = SimpleNamespace(add_ao_voltage_chan=self._add_output)
        self.do_channels = SimpleNamespace(add_do_chan=self._add_lines)
        self.timing = SimpleNamespace(cfg_samp_clk_timing=self._set_clock, samp_clk_rate=None)
        self.in_stream = SimpleNamespace(task=self)
        self.out_stream = SimpleNamespace(task=self, regen_mode="allowed")

    def _add_input(self, physical_channel, terminal_config, min_val, max_val):
        self.kind = "input"
        self.channels.append(physical_channel)

    def _add_output(self, physical_channel, min_val, max_val):
        self.kind = "output"
        self.channels.append(physical_channel)
        self.ranges_v.append((min_val, max_val))

    def _add_lines(self, lines, line_grouping):
        assert line_grouping == "one channel"
        self.kind = "lines"
        self.channels.append(lines)

    def _set_clock(self, rate, source="", sample_mode=None, samps_per_chan=1000):
        self.source, self.timing.samp_clk_rate = source, self.card.clock_hz
        assert sample_mode == "continuous"
        if self.kind == "input":
            self.card.input_buffer = samps_per_chan

    def start(self):
        if self.kind != "input":
            assert self.out_stream.regen_mode == "none"
            assert self.source == "/Dev1/ai/SampleClock"
            assert not self.card.input_runs, "an output must wait for the clock"
        if self.kind == "output":
            self.card.output_runs = True
        elif self.kind == "lines":
            self.card.lines_run = True
        else:
            self.card.input_runs = True

    def write(self, data, auto_start):
        assert isinstance(data, float if len(self.channels) == 1 else list)
        self.check(np.reshape(data, (len(self.channels), 1)))
        assert auto_start and not self.card.output_runs
        self.card.held_v = data if isinstance(data, float) else np.array(data)
        self.card.single_v.append(self.card.held_v)

    def check(self, data_v):
        for of_channel_v, (lowest_v, highest_v) in zip(data_v, self.ranges_v, strict=True):
            if of_channel_v.min() < lowest_v or of_channel_v.max() > highest_v:
                raise DaqError(
                    "Requested value is not a supported value for this property.", -200077)

    def close(self):
        self.card.open_tasks -= 1
        if self.kind == "output":
            self.card.output_runs = False
        elif self.kind == "lines":
            self.card.lines_run = False
        else:
            self.card.input_runs = False


class Reader:
    """As ``nidaqmx.stream_readers.AnalogSingleChannelReader``."""

    def __init__(self, task_in_stream):
        self._card = task_in_stream.task.card
        assert len(task_in_stream.task.channels) == 1

    def read_many_sample(self, data, number_of_samples_per_channel, timeout):
        card = self._card
        if not card.input_runs:
            raise DaqError("Some or all of the samples requested have not yet been acquired.",
                           -200284)
        card.be_late(max(0, number_of_samples_per_channel - len(card.measured_v)))
        if card.fault and card.fault.error_code == -200279:
            raise card.fault
        self.fill(data, card.measured_v[:number_of_samples_per_channel])
        del card.measured_v[:number_of_samples_per_channel]

    @staticmethod
    def fill(data, measured_v):
        assert data.ndim == 1
        data[:] = measured_v


class AxesReader(Reader):
    """As ``nidaqmx.stream_readers.AnalogMultiChannelReader``: data of shape (channels, samples)."""

    def __init__(self, task_in_stream):
        self._card, self._channels = task_in_stream.task.card, task_in_stream.task.channels

    def fill(self, data, measured_v):
        assert data.shape == (len(self._channels), len(measured_v)) and data.flags.c_contiguous
        data[:] = np.transpose(measured_v)


class Writer:
    """As ``nidaqmx.stream_writers.AnalogSingleChannelWriter``."""

    def __init__(self, task_out_stream, auto_start):
        assert not auto_start
        self._task = task_out_stream.task

    def write_many_sample(self, data, timeout):
        assert data.dtype == np.float64
        self._task.check(self.by_channel(data))
        if self._task.card.fault:
            raise self._task.card.fault
        self._task.card.waiting_v.extend(data.T)

    @staticmethod
    def by_channel(data):
        assert data.ndim == 1
        return data[None]


class AxesWriter(Writer):
    """As ``nidaqmx.stream_writers.AnalogMultiChannelWriter``: data of shape (channels, samples)."""

    @staticmethod
    def by_channel(data):
        assert data.ndim == 2 and data.flags.c_contiguous
        return data


class LinesWriter:
    """As ``nidaqmx.stream_writers.DigitalSingleChannelWriter``: a byte for each sample."""

    def __init__(self, task_out_stream, auto_start):
        assert not auto_start and len(task_out_stream.task.channels) == 1
        self._card = task_out_stream.task.card

    def write_many_sample_port_byte(self, data, timeout):
        assert data.dtype == np.uint8 and data.ndim == 1
        self._card.waiting_marks.extend(data)
