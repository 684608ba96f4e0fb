# SPDX-License-Identifier: BSD-3-Clause
"""Recordings of the simulated stage, or of any model with noise, without a recorder node."""

import numpy as np

from piezo_models.linear.dynamics import continue_linear, zoh
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag
from piezo_sim.simulated_stage import SimulatedStage

CLOCK_HZ = 40_000.0
STAGE_NOISE_UM = 0.009
"""Noise of the sensors of the thesis (1.3) and of the simulated stage."""

ROWS_LATE = 0.0
"""Known delay of the displacements of these recordings in sample periods, which is not fitted."""

SAMPLES_AT_ONCE = 400_000
"""Number of clock samples simulated at once."""


def record_stage(name, voltage_v, before_v=(), held=1, clock_hz=CLOCK_HZ, seed=1, plant=None):
    """Play voltages, (N,), on the simulated stage, which has rested at 0 V, and record them.

    A ramp from rest, (M,), is played first. Each voltage is held for some clock samples, over which
    the displacement is averaged.
    """
    stage = SimulatedStage(plant, seed, clock_hz)
    stage.open()
    played_v = np.concatenate([before_v, voltage_v])
    displacement_um = np.empty(played_v.size)
    block = max(1, SAMPLES_AT_ONCE // held)
    for start in range(0, played_v.size, block):
        part = slice(start, start + block)
        clock_um = stage.exchange(np.repeat(played_v[part], held))
        displacement_um[part] = clock_um.reshape(-1, held).mean(axis=1)
    return recording(name, played_v, displacement_um, clock_hz, held, len(before_v))


def record_experiment(experiment, clock_hz=CLOCK_HZ, seed=1, plant=None):
    """Record an experiment on the simulated stage after a quick ramp from rest."""
    held = round(experiment.sample_period_s * clock_hz)
    count = max(1, round(0.1 * clock_hz / held))
    before_v = np.linspace(0.0, experiment.voltage_v[0], count)
    voltage_v = np.tile(experiment.voltage_v, experiment.repeats)
    return record_stage(experiment.name, voltage_v, before_v, held, clock_hz, seed, plant)


def record_model(name, model, voltage_v, sample_period_s, noise_um, seed=1):
    """Record a model that begins with all relays off and without creep, with white noise."""
    linear = zoh(model.linear(), sample_period_s)
    displacement_um, _ = continue_linear(
        linear, model.hysteresis.simulate(voltage_v), np.zeros(linear.nstates)
    )
    noise_um = noise_um * np.random.default_rng(seed).standard_normal(voltage_v.size)
    return recording(name, voltage_v, displacement_um + noise_um, 1.0 / sample_period_s)


def recording(name, voltage_v, displacement_um, clock_hz, held=1, before=0):
    """Return uniform samples as a recording; the first `before` are flagged as a ramp."""
    flags = np.full(voltage_v.size, Flag.PLAYING, dtype=np.uint32)
    flags[:before] = Flag.RAMPING
    return Recording(
        path=name, sample_rate_hz=clock_hz,
        sample_index=np.arange(voltage_v.size, dtype=np.int64) * held,
        sample_periods_s=np.full(voltage_v.size, held / clock_hz),
        voltage_v=voltage_v, displacement_um=displacement_um, flags=flags,
    )
