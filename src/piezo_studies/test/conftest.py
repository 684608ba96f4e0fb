# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of tracking runs with known errors, made without ROS."""

import json
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from piezo_recorder.sample_block import TYPE_NAME, Flag
from piezo_recorder.writing.message_definition import MessageDefinition
from piezo_recorder.writing.writer import RecordingWriter

MESSAGE_FILE = Path(__file__).parents[2] / "piezo_interfaces" / "msg" / "SampleBlock.msg"
SAMPLE_RATE_HZ = 40_000
TICK = 40
LEAD_IN_SAMPLES = 2000
FIRST_SAMPLE = 12_000


class TrackingRecordings:
    """Write what the recorder would of a tracking run, with given signals."""

    def __init__(self):
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._types.register(
            get_types_from_msg(MESSAGE_FILE.read_text(encoding="utf-8"), TYPE_NAME))
        text, _ = self._types.generate_msgdef(TYPE_NAME, ros_version=2)
        self._definition = MessageDefinition(TYPE_NAME, text)

    def write(self, path, mode="composite", frequency_hz=100.0, amplitude_um=40.0, error_um=0.0,
              true_error_um=0.0, voltage_v=0.0, duration_s=0.1, block_wall_s=0.0005, missed=0,
              truth=True):
        """Write a run whose displacement is the reference minus the given errors.

        Before the periodic part lies an approach far away from the reference, and samples at rest
        lie around the whole. Blocks are logged ``block_wall_s`` apart while tracking, a second
        apart otherwise.
        """
        count = round(duration_s * SAMPLE_RATE_HZ)
        time_s = np.arange(count) / SAMPLE_RATE_HZ
        reference_um = 50.0 + 0.5 * amplitude_um * np.sin(2 * np.pi * frequency_hz * time_s)

        def around(signal):
            return np.r_[np.full(TICK + LEAD_IN_SAMPLES, -9.0), signal, np.full(TICK, 7.0)]

        measured_um = around(reference_um - error_um)
        true_um = around(reference_um - true_error_um)
        applied_v = around(voltage_v + np.zeros(count))
        with RecordingWriter(path, SAMPLE_RATE_HZ) as writer:
            writer.attach("parameters.json", json.dumps(
                _parameters(mode, frequency_hz, amplitude_um, duration_s)).encode())
            samples = writer.add_topic("/samples", self._definition)
            ground_truth = writer.add_topic("/ground_truth", self._definition)
            time_ns = 0
            for start in range(0, measured_um.size, TICK):
                tracking = TICK <= start < measured_um.size - TICK
                part = slice(start, start + TICK)
                writer.write(samples, self._block(
                    FIRST_SAMPLE + start, applied_v[part], measured_um[part],
                    Flag.TRACKING if tracking else Flag(0), missed), time_ns)
                time_ns += round(1e9 * (block_wall_s if tracking else 1.0))
            if truth:
                writer.write(ground_truth, self._block(
                    FIRST_SAMPLE, applied_v, true_um, Flag(0), missed), time_ns)
        return path

    def _block(self, first_sample, voltage_v, displacement_um, flags, missed):
        types = self._types.types
        header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "stage")
        return bytes(self._types.serialize_cdr(types[TYPE_NAME](
            header=header, first_sample=first_sample, sample_period_s=1 / SAMPLE_RATE_HZ,
            tick=first_sample // TICK + 1, voltage_v=np.asarray(voltage_v, float),
            displacement_um=np.asarray(displacement_um, float), flags=int(flags),
            missed_feedback=missed, axes=[], marks=np.empty(0, np.uint8),
            signals=[], signal=np.empty(0)), TYPE_NAME))


def _parameters(mode, frequency_hz, amplitude_um, duration_s):
    return {"mode": mode, "duration_s": duration_s, "reference": {
        "kind": "harmonic", "frequency_hz": [frequency_hz], "amplitude_um": [amplitude_um],
        "phase_rad": [], "centre_um": 50.0, "file": ""}}


@pytest.fixture(scope="session")
def tracking_recordings():
    return TrackingRecordings()
