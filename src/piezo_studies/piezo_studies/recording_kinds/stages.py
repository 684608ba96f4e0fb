# SPDX-License-Identifier: BSD-3-Clause
"""Two stages of other mathematical forms than the model: generalised plays, and a Duhem equation.

Both creep by the logarithm of time, through many poles that no fit knows. An amplifier's lag and
modes side by side follow. Rows are read at the instant at which their voltage changes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import cont2discrete, lfilter

from piezo_common.arrays import FloatArray

REST_S = 20.0
"""For how long a stage rests under the first voltage of a recording, after a rise from 0 V."""

RISE_ROWS = 400
"""Rows of that rise."""

LONGEST_STEP_S = 1e-4
"""Steps in which a stage creeps and rings within a row."""


@dataclass(frozen=True)
class Linear:
    """What follows the hysteresis.

    Attributes
    ----------
    creep_per_decade : float
        Part of the displacement by which it creeps in every decade of time.
    lag_s : float
    modes : tuple of (float, float, float)
        Frequency (Hz), damping ratio, and part of the compliance; the parts sum to one.
    """

    creep_per_decade: float
    lag_s: float
    modes: tuple[tuple[float, float, float], ...]

    def displacement_um(self, driving_um: FloatArray, period_s: float,
                        lead_um: FloatArray, lead_period_s: float) -> FloatArray:
        """Return the answer to what the hysteresis puts in, held between the rows.

        Parameters
        ----------
        driving_um : ndarray, shape (N,)
        period_s : float
        lead_um : ndarray, shape (M,)
            What came before; the modes are at rest after it.
        lead_period_s : float

        Returns
        -------
        ndarray, shape (N,)
        """
        steps = max(1, round(period_s / LONGEST_STEP_S))
        driving_um, period_s = np.repeat(driving_um, steps), period_s / steps
        crept_um = driving_um.copy()
        for time_s in np.logspace(-3, 4, 22):
            part = self.creep_per_decade / 3.0
            state = 0.0
            for signal_um, step_s in ((lead_um, lead_period_s), (driving_um, period_s)):
                kept = np.exp(-step_s / time_s)
                answer, last = lfilter([0.0, 1.0 - kept], [1.0, -kept], signal_um, zi=[state])
                state = float(last[0])
            crept_um += part * answer
        answer_um = np.zeros_like(crept_um)
        for frequency_hz, damping, part in self.modes:
            w = 2.0 * np.pi * frequency_hz
            denominator = np.polymul([self.lag_s, 1.0], [w**-2, 2.0 * damping / w, 1.0])
            b, a, _ = cont2discrete(([part], denominator), period_s)
            answer_um += lfilter(b.ravel(), a, crept_um - crept_um[0]) + part * crept_um[0]
        return answer_um[::steps]


class Stage:
    """A hysteresis, and what follows it.

    Parameters
    ----------
    linear : Linear
    """

    def __init__(self, linear: Linear) -> None:
        self._linear = linear

    def hysteresis_um(self, voltage_v: FloatArray) -> FloatArray:
        """Return what the hysteresis makes of a voltage that begins at 0 V, never cycled before."""
        raise NotImplementedError

    def displacement_um(self, voltage_v: FloatArray, period_s: float) -> FloatArray:
        """Return where a stage is while a voltage plays.

        Parameters
        ----------
        voltage_v : ndarray, shape (N,)
        period_s : float
            Of the rows.

        Returns
        -------
        ndarray, shape (N,)
        """
        lead_v = np.append(np.linspace(0.0, voltage_v[0], RISE_ROWS),
                           np.full(RISE_ROWS, voltage_v[0]))
        driving_um = self.hysteresis_um(np.append(lead_v, voltage_v))
        return self._linear.displacement_um(
            driving_um[lead_v.size :], period_s, driving_um[: lead_v.size], REST_S / RISE_ROWS)


class PlayStage(Stage):
    """Generalised plays, whose sides are curves of the voltage, over 100 V and some 13 um."""

    def __init__(self) -> None:
        super().__init__(Linear(0.012, 4e-4, ((620.0, 0.02, 0.92), (1450.0, 0.015, 0.08))))

    def hysteresis_um(self, voltage_v: FloatArray) -> FloatArray:
        """Return the sum of plays between two curves of the voltage."""
        widths = np.linspace(0.0, 25.0, 12)
        weights = 0.12 * np.append(0.8, 0.04 * np.exp(-widths[1:] / 15.0))
        rising = (voltage_v + 1.5e-3 * voltage_v**2)[:, None] - widths
        falling = (voltage_v + 1.0e-3 * voltage_v**2 + 2e-3 * voltage_v)[:, None] + widths
        driven_um, state = np.empty(voltage_v.size), np.zeros(widths.size)
        for n in range(voltage_v.size):
            state = np.maximum(rising[n], np.minimum(falling[n], state))
            driven_um[n] = weights @ state
        return driven_um


class DuhemStage(Stage):
    """The Duhem equation of Coleman and Hodgdon, over 100 V and some 30 um; slower modes."""

    def __init__(self) -> None:
        super().__init__(Linear(0.008, 8e-4, ((210.0, 0.03, 0.9), (760.0, 0.02, 0.1))))

    def hysteresis_um(self, voltage_v: FloatArray) -> FloatArray:
        """Return a solution of s' = 0.4 v' + 0.03 |v'| (0.5 v - s)."""
        driven_um, state, before_v = np.empty(voltage_v.size), 0.0, 0.0
        for n, now_v in enumerate(voltage_v.tolist()):
            change_v = now_v - before_v
            # Large steps are gone in parts, as the equation is of small ones.
            parts = int(abs(change_v) / 0.5) + 1
            for _ in range(parts):
                before_v += change_v / parts
                state += (0.4 * change_v + 0.03 * abs(change_v) * (0.5 * before_v - state)) / parts
            before_v = now_v
            driven_um[n] = 0.2 * now_v + 0.2 * state
        return driven_um
