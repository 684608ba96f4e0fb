# SPDX-License-Identifier: BSD-3-Clause
"""Time the diagnosis of a million samples beside one simulation of them."""

import time
from dataclasses import replace

import numpy as np
from stage_model import SAMPLE_RATE_HZ, stage_model

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

SAMPLES = 1_000_000
LEVEL_S, LEVELS_V = 0.02, (5.0, 95.0)
MODE = VibrationMode(8800.0, 0.02, 0.02)
NOISE_UM = 0.009


def recording_with_a_mode(model):
    """Random levels on a stage with one mode more than the model has."""
    generator = np.random.default_rng(0)
    held = round(LEVEL_S * SAMPLE_RATE_HZ)
    voltage_v = np.repeat(generator.uniform(*LEVELS_V, -(-SAMPLES // held)), held)[:SAMPLES]
    displacement_um = replace(model, effects=(MODE,)).simulate(voltage_v, 1.0 / SAMPLE_RATE_HZ)
    return Recording(
        path="random levels", sample_rate_hz=SAMPLE_RATE_HZ, sample_index=np.arange(SAMPLES),
        sample_periods_s=np.full(SAMPLES, 1.0 / SAMPLE_RATE_HZ), voltage_v=voltage_v,
        displacement_um=displacement_um + generator.normal(scale=NOISE_UM, size=SAMPLES),
        flags=np.full(SAMPLES, Flag.PLAYING, dtype=np.uint32),
    )


def diagnosis_times_s():
    """Time of a simulation, and of the diagnosis that finds the mode.

    Returns
    -------
    simulation_s, diagnosis_s : float
    """
    model = stage_model()
    recording = recording_with_a_mode(model)
    times_s = [time.perf_counter()]
    model.simulate(recording.voltage_v, 1.0 / SAMPLE_RATE_HZ)
    times_s.append(time.perf_counter())
    found = diagnose(model, [recording])
    times_s.append(time.perf_counter())
    names = [entry["name"] for entry in found.effects]
    if names[:1] != [MODE.name]:
        raise RuntimeError(f"{names} found in place of {MODE.name}")
    return tuple(np.diff(times_s))
