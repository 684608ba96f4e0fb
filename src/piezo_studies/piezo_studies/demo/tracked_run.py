# SPDX-License-Identifier: BSD-3-Clause
"""Read the signals and the reference of a tracking run from its recording."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader

from piezo_controller.references.reference import Reference, sample_reference
from piezo_recorder.reading.reader import GROUND_TRUTH, read_recording


@dataclass(frozen=True, eq=False)
class TrackedRun:
    """The periodic part of a run, which follows the approach."""

    mode: str

    frequency_hz: float
    amplitude_um: float
    centre_um: float
    """Frequency, peak-to-peak amplitude and centre of the harmonic reference."""
    sample_rate_hz: float

    reference_um: np.ndarray
    displacement_um: np.ndarray
    true_um: np.ndarray
    """Reference, displacement measured by the sensor, and true displacement of the simulator,
    (N,)."""
    voltage_v: np.ndarray
    """Applied voltage, (N,)."""
    loop_s: float
    loop_wall_s: float
    """Stage time and wall time from the first block of the loop to the last."""
    missed_feedback: int
    """Number of ticks without new feedback."""
    path: str
    """Path of the recording."""

    @property
    def time_s(self):
        """Time since the periodic part began, shape (N,)."""
        return np.arange(len(self.reference_um)) / self.sample_rate_hz

    @property
    def error_um(self):
        """Reference minus measured displacement, shape (N,)."""
        return self.reference_um - self.displacement_um


def read_tracked_run(path):
    """Read the rosbag2 directory of a ``track`` action with a harmonic reference.

    ValueError is raised if samples or parameters are missing.
    """
    recording = read_recording(path)
    parameters = _parameters(recording)
    reference = Reference(**parameters["reference"])
    tracked = recording.select(recording.tracking)
    count = round(parameters["duration_s"] * recording.sample_rate_hz)
    part = tracked.select(np.arange(len(tracked.sample_index)) >= tracked.sample_index.size - count)
    if tracked.gaps or part.sample_index.size < count:
        raise ValueError(f"{path} has gaps in the run: track again")
    loop_samples, loop_wall_s, missed = _loop_times(path, *tracked.sample_index[[0, -1]])
    return TrackedRun(
        mode=parameters["mode"], frequency_hz=reference.frequency_hz[0],
        amplitude_um=reference.amplitude_um[0], centre_um=reference.centre_um,
        sample_rate_hz=recording.sample_rate_hz,
        reference_um=np.resize(sample_reference(reference, recording.sample_rate_hz), count),
        displacement_um=part.displacement_um, true_um=_true_displacement_um(path, part),
        voltage_v=part.voltage_v, loop_s=loop_samples / recording.sample_rate_hz,
        loop_wall_s=loop_wall_s, missed_feedback=missed, path=str(path))


def _parameters(recording):
    try:
        return json.loads(recording.attachments["parameters.json"])
    except (KeyError, ValueError):
        raise ValueError(f"{recording.path} has no parameters.json of a tracking run: "
                         "give the recording of the track action") from None


def _true_displacement_um(path, part):
    truth = read_recording(path, topic=GROUND_TRUTH, sample_rate_hz=part.sample_rate_hz)
    at = np.searchsorted(truth.sample_index, part.sample_index)
    if at[-1] >= truth.sample_index.size or (truth.sample_index[at] != part.sample_index).any():
        raise ValueError(f"{path} has gaps in the ground truth: track again")
    return truth.displacement_um[at]


def _loop_times(path, first_sample, last_sample):
    """Return samples and wall time of the loop, and the number of ticks without feedback."""
    with AnyReader([Path(path)]) as reader:
        samples = [connection for connection in reader.connections
                   if connection.msgtype.endswith("/SampleBlock")
                   and not connection.topic.endswith("/" + GROUND_TRUTH)]
        blocks: list[tuple[int, Any]] = [
            (time_ns, reader.deserialize(data, connection.msgtype))
            for connection, time_ns, data in reader.messages(samples)]
    loop = [(time_ns, block) for time_ns, block in blocks
            if first_sample <= block.first_sample <= last_sample]
    (begin_ns, first), (end_ns, last) = loop[0], loop[-1]
    return (last.first_sample - first.first_sample, 1e-9 * (end_ns - begin_ns),
            last.missed_feedback)
