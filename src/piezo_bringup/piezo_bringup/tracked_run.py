# SPDX-License-Identifier: BSD-3-Clause
"""Read the recording of one tracking run back into signals beside its reference."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

from piezo_controller.references import Reference, sample_reference
from piezo_recorder.reader import GROUND_TRUTH, read_recording


@dataclass(frozen=True, eq=False)
class TrackedRun:
    """The periodic part of a run: what the reference repeats in, after the lead-in.

    Attributes
    ----------
    mode : str
    frequency_hz, amplitude_um, centre_um : float
        Of the harmonic reference; the amplitude is peak to peak.
    sample_rate_hz : float
    reference_um, displacement_um, true_um : ndarray, shape (N,)
        Wanted, measured by the sensor, and true in the simulator.
    voltage_v, feedback_v : ndarray, shape (N,)
        Applied, and the feedback's share of it.
    loop_s, loop_wall_s : float
        Stage time and wall time from the first block of the loop to the last.
    missed_feedback : int
        Ticks that had to do without a new answer.
    path : str
        Of the recording.
    """

    mode: str
    frequency_hz: float
    amplitude_um: float
    centre_um: float
    sample_rate_hz: float
    reference_um: np.ndarray
    displacement_um: np.ndarray
    true_um: np.ndarray
    voltage_v: np.ndarray
    feedback_v: np.ndarray
    loop_s: float
    loop_wall_s: float
    missed_feedback: int
    path: str

    @property
    def time_s(self):
        """Time since the periodic part began, shape (N,)."""
        return np.arange(len(self.reference_um)) / self.sample_rate_hz

    @property
    def error_um(self):
        """Reference minus measured displacement, shape (N,)."""
        return self.reference_um - self.displacement_um

    @property
    def feedforward_v(self):
        """The feedforward's share of the voltage, shape (N,)."""
        return self.voltage_v - self.feedback_v


def read_tracked_run(path):
    """Read the recording of a ``track`` action with a harmonic reference.

    Parameters
    ----------
    path : path-like
        The rosbag2 directory.

    Returns
    -------
    TrackedRun

    Raises
    ------
    ValueError
        If samples or parameters are missing.
    """
    recording = read_recording(path)
    parameters = _parameters(recording)
    reference = Reference(**parameters["reference"])
    tracked = recording.select(recording.tracking)
    count = round(parameters["duration_s"] * recording.sample_rate_hz)
    part = tracked.select(np.arange(len(tracked.sample_index)) >= tracked.sample_index.size - count)
    if tracked.gaps or part.sample_index.size < count:
        raise ValueError(f"{path} lacks samples of the run: track again")
    ticks = _read_ticks(path, tracked.sample_index[0], tracked.sample_index[-1])
    return TrackedRun(
        mode=parameters["mode"], frequency_hz=reference.frequency_hz[0],
        amplitude_um=reference.amplitude_um[0], centre_um=reference.centre_um,
        sample_rate_hz=recording.sample_rate_hz,
        reference_um=np.resize(sample_reference(reference, recording.sample_rate_hz), count),
        displacement_um=part.displacement_um, true_um=_true_displacement_um(path, part),
        voltage_v=part.voltage_v, feedback_v=ticks.feedback_v(part.sample_index),
        loop_s=ticks.loop_s(recording.sample_rate_hz), loop_wall_s=ticks.loop_wall_s,
        missed_feedback=ticks.missed_feedback, path=str(path))


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
        raise ValueError(f"{path} lacks samples of the ground truth: track again")
    return truth.displacement_um[at]


@dataclass(frozen=True, eq=False)
class _Ticks:
    """Blocks of the loop and the answers to them, in the order of the ticks."""

    first_sample: np.ndarray
    tick: np.ndarray
    log_time_ns: np.ndarray
    samples_per_tick: int
    missed_feedback: int
    answered_tick: np.ndarray
    answer_v: np.ndarray

    @property
    def loop_wall_s(self):
        return 1e-9 * float(self.log_time_ns[-1] - self.log_time_ns[0])

    def loop_s(self, sample_rate_hz):
        return float(self.first_sample[-1] - self.first_sample[0]) / sample_rate_hz

    def feedback_v(self, sample_index):
        """Feedback that acts at the samples: an answer is held from the tick after its own on."""
        since_first = (sample_index - self.first_sample[0]) // self.samples_per_tick
        # A block carries the tick after its samples.
        tick = self.tick[0] - 1 + since_first
        latest = np.searchsorted(self.answered_tick + 1, tick, side="right")
        return np.r_[0.0, self.answer_v][latest]


def _read_ticks(path, first_sample, last_sample):
    with AnyReader([Path(path)]) as reader:
        def messages(kind):
            wanted = [c for c in reader.connections if c.msgtype.endswith(kind)
                      and not c.topic.endswith("/" + GROUND_TRUTH)]
            for connection, time_ns, data in reader.messages(wanted) if wanted else ():
                yield time_ns, reader.deserialize(data, connection.msgtype)

        blocks = [(time_ns, block.first_sample, block.tick, len(block.displacement_um),
                   block.missed_feedback)
                  for time_ns, block in messages("/SampleBlock")
                  if first_sample <= block.first_sample <= last_sample]
        answers = [(answer.tick, answer.voltage_v) for _, answer in messages("/FeedbackVoltage")]
    log_time_ns, first, tick, counts, missed = np.array(blocks, dtype=np.int64).T
    answers = np.array(answers).reshape(-1, 2)
    return _Ticks(first, tick, log_time_ns, int(counts[0]), int(missed[-1]),
                  answers[:, 0].astype(np.int64), answers[:, 1])
