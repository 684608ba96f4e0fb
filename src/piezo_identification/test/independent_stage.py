# SPDX-License-Identifier: BSD-3-Clause
"""A stage that shares no code with the model: modes as a second-order system, play hysteresis.

Its modes are those of masses and springs, M q'' + D q' + K q = force, solved by the matrix
exponential; a lag drives them, and a sensor with a lag, a delay and an instant of reading of its
own looks at them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, expm
from scipy.signal import lfilter

from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag


@dataclass(frozen=True)
class IndependentStage:
    """Amplifier's lag, modes that add up, sensor, and how the logger reads it.

    Parameters
    ----------
    lag_s : float
    modes : tuple of (float, float, float)
        Frequency (rad/s), damping ratio, and part of the compliance; the parts sum to one.
    sensor_lag_s, delay_s : float
    read_at : float
        Instant within the hold of a row's voltage at which its displacement is read.
    stiffening_per_um2 : float
        Of the spring: the displacement is that much less, times its cube.
    gains_um_per_v, half_widths_v : tuple of float
        Of the play operators.
    """

    lag_s: float
    modes: tuple
    sensor_lag_s: float = 0.0
    delay_s: float = 0.0
    read_at: float = 0.0
    stiffening_per_um2: float = 0.0
    gains_um_per_v: tuple = (0.5, 0.2, 0.1)
    half_widths_v: tuple = (0.0, 4.0, 12.0)

    def hysteresis_um(self, voltage_v):
        """Sum of play operators."""
        total_um = np.zeros(voltage_v.size)
        for gain, width in zip(self.gains_um_per_v, self.half_widths_v, strict=True):
            state = 0.0
            for n, voltage in enumerate(voltage_v):
                state = min(max(state, voltage - width), voltage + width)
                total_um[n] += gain * state
        return total_um

    def matrices(self):
        """A, B, C of lag, modes and sensor."""
        count = len(self.modes)
        w, zeta, part = np.array(self.modes).reshape(count, 3).T
        modal = np.block([[np.zeros((count, count)), np.eye(count)],
                          [-np.diag(w**2), -np.diag(2.0 * zeta * w)]])
        a = block_diag([[-1.0 / self.lag_s]], modal)
        a[1 + count :, 0] = w**2
        b = np.zeros(1 + 2 * count)
        b[0] = 1.0 / self.lag_s
        c = np.concatenate([[0.0], part, np.zeros(count)])
        if self.sensor_lag_s:
            a = block_diag(a, [[-1.0 / self.sensor_lag_s]])
            a[-1, :-1] = c / self.sensor_lag_s
            b, c = np.append(b, 0.0), np.append(np.zeros(b.size), 1.0)
        return a, b, c

    def displacement_um(self, voltage_v, sample_period_s):
        """Displacement of every row, from rest under the first voltage."""
        a, b, c = self.matrices()
        driving_um = self.hysteresis_um(voltage_v)

        def over(time_s):
            whole = expm(np.block([[a, b[:, None]], [np.zeros((1, b.size + 1))]]) * time_s)
            return whole[:-1, :-1], whole[:-1, -1]

        late, part = divmod(self.read_at - self.delay_s / sample_period_s, 1.0)
        transition, gain = over(sample_period_s)
        to_reading, gain_of_reading = over(part * sample_period_s)
        # Each of the distinct poles is a recursion of its own.
        poles, shapes = np.linalg.eig(transition)
        pushes, first = np.linalg.solve(
            shapes, np.column_stack([gain, np.linalg.solve(a, -b * driving_um[0])])).T
        states = [lfilter([0.0, push], [1.0, -pole], driving_um, zi=[begin])[0]
                  for pole, push, begin in zip(poles, pushes, first, strict=True)]
        read_um = (c @ to_reading @ shapes @ states).real + c @ gain_of_reading * driving_um
        rows = np.clip(np.arange(voltage_v.size) + int(late), 0, voltage_v.size - 1)
        read_um = read_um[rows]
        return read_um - self.stiffening_per_um2 * read_um**3

    def record(self, voltage_v, sample_period_s, noise_um=0.0, seed=0):
        """Recording of the rows of a waveform."""
        noise = noise_um * np.random.default_rng(seed).normal(size=voltage_v.size)
        return Recording(
            "independent stage", 1.0 / sample_period_s, np.arange(voltage_v.size),
            np.full(voltage_v.size, sample_period_s), voltage_v,
            self.displacement_um(voltage_v, sample_period_s) + noise,
            np.full(voltage_v.size, Flag.PLAYING, dtype=np.uint32))


def square_wave_v(period_s=0.02, sample_period_s=25e-6, periods=45, low_v=20.0, high_v=80.0):
    """Square wave that begins at its upper level."""
    half = round(0.5 * period_s / sample_period_s)
    return np.tile(np.repeat([high_v, low_v], half), periods)
