# SPDX-License-Identifier: BSD-3-Clause
"""An NV200: what the documentation of its library says of its commands, and a stage behind it.

It takes and answers command lines. Time passes only while somebody asks whether the generator runs.
`library` is the part of the package ``nv200`` that a stage needs, over such lines.
"""

from enum import Enum
from types import SimpleNamespace

LOWEST_V, HIGHEST_V = -20.0, 130.0
STEPS_PER_QUESTION = 20000
POSITION, VOLTAGE = 0, 2


class DeviceError(Exception):
    """As ``nv200.shared_types.DeviceError``."""


class Box:
    """Hold the state of one NV200.

    Attributes
    ----------
    held_v : float
        What is put out; the stage has 1 um for each volt.
    sent_v : list of float
        Every voltage of a single command.
    """

    def __init__(self, um_per_v=1.0, deaf_servo=False, played_scale=1.0):
        self.um_per_v, self.deaf_servo, self.played_scale = um_per_v, deaf_servo, played_scale
        self.held_v, self.gone, self.connected, self.sent_v = 0.0, False, False, []
        self.values = {"cl": "1", "gtarb": "1", "recstr": "1", "reclen": "6144", "recast": "0",
                       "modsrc": "0", "gcarb": "0", "gearb": "0", "goarb": "0", "gsarb": "0"}
        self.buffer_v = [0.0] * 1024
        self.sources, self.record = {0: 0, 1: 0}, {0: [], 1: []}
        self.running = self.recording = False
        self.played = 0

    def answer(self, line):
        """Carry out a command; return what the device says to it."""
        if self.gone:
            raise OSError("could not write to the port")
        name, *words = line.strip().split(",")
        act = getattr(self, f"_{name}", None) if name else None
        if not name:
            return "NV200/D_NET"
        if act is not None:
            return act(*words)
        if words:
            self.values[name] = words[0]
        if name == "cl" and self.deaf_servo:
            self.values["cl"] = "1"
        return f"{name},{self.values[name]}"

    def _avmin(self):
        return f"avmin,{LOWEST_V}"

    def _avmax(self):
        return f"avmax,{HIGHEST_V}"

    def _meas(self):
        return f"meas,{self.um_per_v * self.held_v:.6f}"

    def _set(self, voltage):
        assert self.values["cl"] == "0" and self.values["modsrc"] == "0" and not self.running
        self.held_v = float(voltage)
        self.sent_v.append(self.held_v)
        return f"set,{voltage}"

    def _gbarb(self, index, percent):
        assert not self.running
        self.buffer_v[int(index)] = LOWEST_V + float(percent) / 100.0 * (HIGHEST_V - LOWEST_V)
        return f"gbarb,{index},{percent}"

    def _recsrc(self, channel, source=None):
        if source is not None:
            self.sources[int(channel)] = int(source)
        return f"recsrc,{channel},{self.sources[int(channel)]}"

    def _grun(self, run=None):
        if run is not None:
            self.running = run == "1"
            if self.running:
                assert self.values["cl"] == "0" and self.values["modsrc"] == "3"
                assert self.values["gcarb"] == "1"
                self.played = int(self.values["goarb"])
                if self.values["recast"] == "2":
                    self._recrun("1")
        elif self.running:
            self._pass_time()
        return f"grun,{int(self.running)}"

    def _recrun(self, run=None):
        if run is not None:
            self.recording = run == "1"
            self.record = {0: [], 1: []}
            if self.recording and not self.running:
                while self.recording:
                    self._record()
        return f"recrun,{int(self.recording)}"

    def _recout(self, channel, index, count):
        return f"recout,{channel},{index},{self.record[int(channel)][int(index)]:.5f}"

    def _recoutf(self, channel):
        return ",".join([f"recoutf,{channel}",
                         *(f"{value:.5f}" for value in self.record[int(channel)])])

    def _pass_time(self):
        assert self.values["gtarb"] == self.values["recstr"], "both must have one rate"
        for _ in range(STEPS_PER_QUESTION // int(self.values["gtarb"])):
            if self.played > int(self.values["gearb"]):
                self.running = False
                break
            before_v = self.held_v
            self.held_v = self.played_scale * self.buffer_v[self.played]
            self._record(before_v)
            self.played += 1

    def _record(self, before_v=None):
        """Store one sample; the sensor shows each voltage one sample later."""
        if not self.recording:
            return
        sensed_v = self.held_v if before_v is None else before_v
        value = {POSITION: self.um_per_v * sensed_v, VOLTAGE: self.held_v}
        for channel, kept in self.record.items():
            kept.append(value.get(self.sources[channel], 0.0))
        self.recording = len(self.record[0]) < int(self.values["reclen"])


class Source(Enum):
    """As ``nv200.data_recorder.DataRecorderSource``."""

    PIEZO_POSITION = POSITION
    PIEZO_VOLTAGE = VOLTAGE


def library(box):
    """Tell what `nv200_stage.load_library` would return."""
    def number(line):
        return float(box.answer(line).split(",")[-1])

    class Device:
        class pid:  # noqa: N801
            @staticmethod
            async def set_closed_loop(enable):
                box.answer(f"cl,{int(enable)}")

            @staticmethod
            async def is_closed_loop():
                return bool(number("cl"))

        async def get_voltage_range(self):
            return number("avmin"), number("avmax")

        async def get_current_position(self):
            return number("meas")

        async def move_to_voltage(self, voltage):
            box.answer("cl,0")
            box.answer("modsrc,0")
            box.answer(f"set,{voltage}")

        async def close(self):
            box.connected = False

    class Generator:
        class WaveformData:
            def __init__(self, values, sample_time_ms):
                self.values, self.sample_time_ms = values, sample_time_ms

        def __init__(self, device):
            pass

        async def set_waveform(self, waveform, unit):
            assert unit == "voltage"
            for index, value in enumerate(waveform.values):
                percent = 100 * (value - LOWEST_V) / (HIGHEST_V - LOWEST_V)
                box.answer(f"gbarb,{index},{percent}")
            box.answer(f"gtarb,{round(waveform.sample_time_ms * 20)}")
            box.answer("goarb,0")
            box.answer(f"gearb,{len(waveform.values) - 1}")

        async def start(self, cycles):
            box.answer(f"gcarb,{cycles}")
            box.answer("modsrc,3")
            box.answer("grun,1")

        async def stop(self):
            box.answer("grun,0")

        async def is_running(self):
            return bool(number("grun"))

    class Recorder:
        def __init__(self, device):
            pass

        async def set_data_source(self, channel, source):
            box.answer(f"recsrc,{channel},{source.value}")

        async def set_autostart_mode(self, mode):
            box.answer(f"recast,{mode}")

        async def set_recorder_stride(self, stride):
            box.answer(f"recstr,{stride}")

        async def set_sample_buffer_size(self, buffer_size):
            box.answer(f"reclen,{buffer_size}")

        async def is_recording(self):
            return bool(number("recrun"))

        async def read_recorded_data_of_channel(self, channel):
            words = box.answer(f"recoutf,{channel}").split(",")[2:]
            return SimpleNamespace(values=[float(word) for word in words])

        async def read_single_value_from(self, source):
            await self.set_autostart_mode(0)
            await self.set_data_source(0, source)
            await self.set_recorder_stride(1)
            await self.set_sample_buffer_size(20)
            box.answer("recrun,1")
            return number("recout,0,0,1")

    async def connect(interface, address):
        if box.gone:
            raise OSError("could not open the port")
        box.connected = True
        return Device()

    return SimpleNamespace(
        connect=connect, Generator=Generator, Recorder=Recorder, Source=Source, Error=DeviceError,
        Unit=SimpleNamespace(VOLTAGE="voltage"),
        AutoStart=SimpleNamespace(START_ON_WAVEFORM_GEN_RUN=2))
