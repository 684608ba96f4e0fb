# SPDX-License-Identifier: BSD-3-Clause
"""A stage of another mathematical form: play operators, and linear dynamics by scipy's lsim."""

import numpy as np
import pytest
from scipy.signal import lsim

from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

RADII_V = np.array([0.0, 2.0, 5.0, 10.0, 18.0, 30.0, 45.0])
WEIGHTS_UM_PER_V = np.array([0.30, 0.06, 0.05, 0.05, 0.04, 0.04, 0.03])


class ForeignStage:
    """Prandtl-Ishlinskii operator, then creep, lag and a mode in one transfer function.

    Parameters
    ----------
    creep : sequence of (float, float)
        Rate (rad/s) and gain of each exponential.
    lag_s, mode, damping : float
        Of the electric lag and of the vibration mode (rad/s); no such dynamics where `mode` is 0.
    is_linear : bool
        Without hysteresis.
    """

    def __init__(self, creep=(), lag_s=0.0, mode=0.0, damping=0.1, is_linear=False):
        self.creep, self.lag_s, self.mode, self.damping = creep, lag_s, mode, damping
        self.is_linear = is_linear

    def hysteresis(self, voltage_v, states=None):
        """Output of play operators; their states at the start are those of a way up from far below
        unless given."""
        if self.is_linear:
            return WEIGHTS_UM_PER_V.sum() * voltage_v
        state = voltage_v[0] - RADII_V if states is None else np.array(states, dtype=float)
        output = np.empty(voltage_v.size)
        for n, v in enumerate(voltage_v):
            state = np.maximum(v - RADII_V, np.minimum(v + RADII_V, state))
            output[n] = WEIGHTS_UM_PER_V @ state
        return output

    def displacement(self, time_s, held_v, states=None):
        """Displacement at the times, each before its voltage acts; at rest in the first voltage."""
        entering = self.hysteresis(held_v, states)
        output = entering - entering[0]
        held = np.append(0.0, output[:-1])
        if self.mode:
            denominator = np.polymul(
                [self.lag_s, 1.0], [self.mode**-2, 2 * self.damping / self.mode, 1.0])
            # lsim with a held input: each sample sees the value from the sample before on.
            held = lsim(([1.0], denominator), output, time_s, interp=False)[1]
        result = held.copy()
        for rate, gain in self.creep:
            result += gain * lsim(([rate], [1.0, rate]), held, time_s, interp=bool(self.mode))[1]
        return entering[0] + result

    def creep_response(self, frequency_hz):
        """Complex response of the creep alone, immediate gain one."""
        s = 2j * np.pi * frequency_hz
        return 1.0 + sum(gain * rate / (s + rate) for rate, gain in self.creep)


def recording_of(voltage_v, displacement_um, sample_period_s, path="record", start=0):
    """Make a recording of rows at their instants."""
    count = voltage_v.size
    return Recording(
        path=path, sample_rate_hz=1.0 / sample_period_s, sample_index=start + np.arange(count),
        sample_periods_s=np.full(count, sample_period_s), voltage_v=voltage_v,
        displacement_um=displacement_um, flags=np.full(count, Flag.PLAYING, dtype=np.uint32))


@pytest.fixture(scope="session")
def record():
    """Play a voltage on a stage and record it, with noise and drift of the sensor."""
    def play(stage, voltage_v, sample_period_s, noise_um=0.003, drift_um=0.0, seed=1, path="record",
             states=None):
        time_s = np.arange(voltage_v.size) * sample_period_s
        displacement_um = stage.displacement(time_s, voltage_v, states)
        noise = np.random.default_rng(seed).normal(scale=noise_um, size=voltage_v.size)
        drift = drift_um * time_s / time_s[-1]
        return recording_of(voltage_v, displacement_um + noise + drift, sample_period_s, path)

    return play


@pytest.fixture(scope="session")
def foreign_stage():
    return ForeignStage
