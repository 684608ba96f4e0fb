# SPDX-License-Identifier: BSD-3-Clause
"""A plant of its own: the thesis' parameters and a density that is no sum f(alpha) + g(beta)."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from replaced import replaced
from scipy.signal import cont2discrete, lfilter
from short_identification import FEW_POLES, WITHOUT_SEARCH, comparing

from piezo_identification.conditioning.waveforms import played
from piezo_identification.estimators.dynamics import pole_search
from piezo_identification.estimators.dynamics.pole_search import MOST_MODES
from piezo_models.cascade import StageModel
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

sys.path.insert(0, str(Path(__file__).parent))  # for made_by_scipy and independent_stage

NOISE_UM = 0.009
RAMP_S, RAMP_ROWS = 0.02, 10
"""Shortest way from rest to the experiment and back."""


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


@pytest.fixture(scope="session", autouse=True)
def few_poles():
    """Let the search for the poles of a fast record begin with 4 modes; no stage here has more.

    `make long` and the tests of this search begin with as many as users do.
    """
    with replaced(*(() if "LONG_TESTS" in os.environ else FEW_POLES)):
        yield


@pytest.fixture
def many_poles(monkeypatch):
    """Let it begin with the modes with which it begins for users."""
    monkeypatch.setattr(pole_search, "MOST_MODES", MOST_MODES)


@pytest.fixture(scope="session")
def few_effects():
    """Returns a context in which a diagnosis compares few effects: it is not asked which of all."""
    return lambda *more: replaced(*comparing("delay", "sensor_lag", "vibration_mode", *more))


@pytest.fixture
def likely_effects():
    """Compare the effects that are found most often: for tests not about which of all it is.

    `make long` compares all.
    """
    few = () if "LONG_TESTS" in os.environ else comparing(
        "amplifier_lag", "creep", "delay", "outliers", "periodic_disturbance", "sensor_lag",
        "sensor_nonlinearity", "thermal_drift", "vibration_mode", "voltage_clipping")
    with replaced(*few):
        yield


@pytest.fixture(scope="module")
def without_search():
    """Fit the model of the separate steps, and no other structure: for tests of what surrounds it.

    From its first use to the end of the module.
    """
    with replaced(*WITHOUT_SEARCH):
        yield


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
        samples = held * max(RAMP_ROWS, -(-round(RAMP_S * clock_hz) // held))
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


class IndependentStage:
    """A stage that shares no form with the model: plays on a curved voltage, then sums of lags.

    Parameters
    ----------
    creep_rates, creep_gains : sequence of float
        Of the lags that add up to the creep.
    time_constant_s, mode_rad_per_s, damping_ratio : float
        Of the dynamics; no dynamics by default.
    plays : bool
        False: no hysteresis, a curve only.
    """

    half_widths_v = np.linspace(1.0, 34.0, 24)

    def __init__(self, creep_rates=(0.125, 2.0), creep_gains=(0.04, 0.02), time_constant_s=0.0,
                 mode_rad_per_s=0.0, damping_ratio=0.05, plays=True):
        self.creep = tuple(zip(creep_rates, creep_gains, strict=True))
        self.time_constant_s, self.plays = time_constant_s, plays
        self.mode = mode_rad_per_s, damping_ratio

    def displacement_um(self, voltage_v, period_s, past_v=(), settled=True):
        """Displacement at the sample instants; the past is met quasi-statically, (N,)."""
        hysteresis_um = self.hysteresis_um(np.append(past_v, voltage_v))[len(past_v):]
        input_um = hysteresis_um
        if self.time_constant_s:
            a, (w, z) = -1.0 / self.time_constant_s, self.mode
            matrix = np.array([[a, 0.0, 0.0], [0.0, 0.0, 1.0], [w * w, -w * w, -2.0 * z * w]])
            drive = np.array([[-a], [0.0], [0.0]])
            step, by_input, *_ = cont2discrete(
                (matrix, drive, np.eye(3), np.zeros((3, 1))), period_s)
            state, output = np.full(3, hysteresis_um[0] if settled else 0.0) * (1, 1, 0), []
            for value in hysteresis_um:
                output.append(state[1])
                state = step @ state + by_input[:, 0] * value
            hysteresis_um = np.array(output)
        displacement_um = hysteresis_um.copy()
        for rate, gain in self.creep:
            decay = np.exp(-rate * period_s)
            start = [input_um[0]] if settled else [0.0]
            displacement_um += gain * lfilter(
                [0.0, 1.0 - decay], [1.0, -decay], hysteresis_um, zi=start)[0]
        return displacement_um

    def hysteresis_um(self, voltage_v):
        """Generalised Prandtl-Ishlinskii: weighted plays on a curve, none displaced at first."""
        driven_v = voltage_v + 1e-3 * voltage_v**2
        if not self.plays:
            return 0.4 * driven_v
        weights = 0.02 * np.exp(-self.half_widths_v / 20.0)
        width_v, state = self.half_widths_v, np.zeros(self.half_widths_v.size)
        output_um = np.empty(driven_v.size)
        for n, v in enumerate(driven_v):
            state = np.minimum(np.maximum(state, v - width_v), v + width_v)
            output_um[n] = 0.2 * v + weights @ state
        return output_um


@pytest.fixture(scope="session")
def independent_stage():
    return IndependentStage


@pytest.fixture(scope="session")
def recorded():
    """A recording of plain arrays, all of it played, as that of a CSV file."""
    def recorded(name, voltage_v, displacement_um, period_s, noise_um=0.0, seed=0):
        noise = noise_um * np.random.default_rng(seed).normal(size=len(voltage_v))
        return Recording(
            path=name, sample_rate_hz=1.0 / period_s, sample_index=np.arange(len(voltage_v)),
            sample_periods_s=np.full(len(voltage_v), period_s),
            voltage_v=np.asarray(voltage_v, dtype=float), displacement_um=displacement_um + noise,
            flags=np.full(len(voltage_v), Flag.PLAYING, dtype=np.uint32))

    return recorded
