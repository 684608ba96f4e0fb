# SPDX-License-Identifier: BSD-3-Clause
"""A plant of its own: the thesis' parameters and a density that is no sum f(alpha) + g(beta)."""

import numpy as np
import pytest

from piezo_identification.conditioning.waveforms import played
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

NOISE_UM = 0.009
RAMP_S = 0.1


def true_density(cells=250):
    """Return the ridge along the diagonal and a bump, on a grid that fits no estimator's."""
    width_v = 140 / cells
    alpha, beta = np.indices((cells, cells)) * width_v - 20 + width_v / 2
    ridge = 0.04 * np.exp(-(alpha - beta) / 25)
    bump = 0.006 * np.exp(-(((alpha - 80) / 30) ** 2 + ((beta - 30) / 25) ** 2))
    return np.tril(0.001 + ridge + bump)


@pytest.fixture(scope="session")
def plant():
    return StageModel(
        PreisachModel(-20.0, 120.0, true_density(), -9.0),
        CreepDynamics((0.01419, 0.1684, 1.053, 17.57), (0.01458, 0.1716, 1.07, 18.29)),
        ElectricVibrationDynamics(0.00049, (2846.0, 4909.0), (0.685, 0.082)),
    )


@pytest.fixture
def noise():
    """Draw white noise of unit variance."""
    return np.random.default_rng(3).normal(size=40_000)


@pytest.fixture(scope="session")
def csv_of(save_csv):
    """Write what a recording played as a CSV file."""
    def write(recording, path):
        part = played(recording)
        return save_csv(path, part.time_s, part.voltage_v, part.displacement_um)

    return write


@pytest.fixture(scope="session")
def play(plant):
    """Play an experiment on the plant from rest as the stage does, and record it."""

    def play_experiment(
        experiment, seed=0, clock_hz=40_000.0, memory=None, noise_um=NOISE_UM, stage=plant
    ):
        held = round(experiment.sample_period_s * clock_hz)
        samples = -(-round(RAMP_S * clock_hz) // held) * held
        ramp = np.arange(1, samples + 1) / samples
        waveform_v = np.repeat(np.tile(experiment.voltage_v, experiment.repeats), held)
        voltage_v = np.concatenate(
            [ramp * waveform_v[0], waveform_v, waveform_v[-1] * (1.0 - ramp)]
        )
        flags = np.repeat(
            np.array([Flag.RAMPING, Flag.PLAYING, Flag.RAMPING], dtype=np.uint32),
            [samples, waveform_v.size, samples],
        )
        displacement_um = stage.simulate(voltage_v, 1.0 / clock_hz, memory)
        # Averaged noise is drawn averaged.
        noise = np.random.default_rng(seed).normal(size=voltage_v.size // held)
        means = displacement_um.reshape(-1, held).mean(axis=1)
        return Recording(
            path=experiment.name,
            sample_rate_hz=clock_hz,
            sample_index=np.arange(0, voltage_v.size, held),
            sample_periods_s=np.full(voltage_v.size // held, experiment.sample_period_s),
            voltage_v=voltage_v.reshape(-1, held).mean(axis=1),
            displacement_um=means + noise_um / np.sqrt(40_000.0 * experiment.sample_period_s)
            * noise,
            flags=flags[::held],
        )

    return play_experiment
