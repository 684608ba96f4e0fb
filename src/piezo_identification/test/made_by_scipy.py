# SPDX-License-Identifier: BSD-3-Clause
"""Recordings that NumPy and SciPy alone have made, of which the models know nothing."""

import numpy as np
from scipy.signal import cont2discrete, lfilter

from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag


def line_model(*mode, gain_um_per_v=0.1):
    """Return a model of a line, with a mode (frequency in rad/s, damping ratio) if one is given."""
    return StageModel(
        PreisachModel.line(-100.0, 100.0, gain_um_per_v, -100.0 * gain_um_per_v), CreepDynamics(),
        ElectricVibrationDynamics(0.0, mode[:1], mode[1:]))


def smooth_noise_v(generator, samples, rows, highest_v=50.0):
    """Draw a voltage about 0 that changes little within a few of so many rows, (samples,)."""
    voltage_v = np.convolve(generator.normal(size=samples), np.hanning(rows), mode="same")
    return voltage_v * (highest_v / np.abs(voltage_v).max())


def behind_mode(driving, frequency_rad_per_s, damping_ratio, period_s=1e-3):
    """Return the answer of a mode, from rest at 0, to samples that are each held, (N,)."""
    w = frequency_rad_per_s
    (numerator,), denominator, _ = cont2discrete(
        ([w * w], [1.0, 2.0 * damping_ratio * w, w * w]), period_s)
    return lfilter(numerator, denominator, driving)


def behind_play(driving, width):
    """Return where a play of some width leaves what it drives, from 0, (N,)."""
    trailing, last = np.empty(driving.size), 0.0
    for n, position in enumerate(driving):
        last = trailing[n] = min(max(last, position - 0.5 * width), position + 0.5 * width)
    return trailing


def logged(voltage_v, displacement_um, period_s=1e-3, name="logged"):
    """Return the recording of a logger, whose rows are read at equal intervals."""
    size = voltage_v.size
    return Recording(
        name, 1.0 / period_s, np.arange(size), np.full(size, period_s), voltage_v, displacement_um,
        np.full(size, Flag.PLAYING, dtype=np.uint32))
