# SPDX-License-Identifier: BSD-3-Clause
"""Repetitive feedback: resonances at a frequency and its multiples, in parallel with PI.

A delay line of one period, the usual internal model of a periodic signal, needs a period of a
whole number of samples, and as many states. Resonances at the multiples that the loop can
attenuate work for any period. The phase of each is chosen to turn the loop away from -1, given the
phase of the stage with the sensitivity of the PI.
"""

import control
import numpy as np

from piezo_common.arrays import FloatArray
from piezo_controller.feedback.sample_rate.classical_forms import FORMS
from piezo_controller.feedback.synthesis.generalised_plant import (
    design_plant,
    nominal_hysteresis_gain,
)
from piezo_models.cascade import StageModel

MOST_MULTIPLES = 8
"""Largest number of multiples; each costs two states."""

DAMPING_RATIO = 1e-4
"""Damping ratio of a resonance, so that its state decays: it attenuates by some 50 dB."""

NAMES = ("gain", "integral", "width")
BOUNDS = (*FORMS["pi"].bounds, (1e-3, 0.5))
START = (*FORMS["pi"].start, 0.03)
"""Parameters of PI, and the half width of a resonance relative to its frequency."""


class Repetitive:
    """Repetitive feedbacks of one fundamental frequency for a model.

    Multiples above the first mode are omitted, as there the model's errors change the phase too
    much.
    """

    def __init__(self, model: StageModel, frequency_hz: float, clock_period_s: float) -> None:
        first_mode_hz = min(model.dynamics.mode_frequencies_rad_per_s) / (2.0 * np.pi)
        count = min(MOST_MULTIPLES, int(first_mode_hz / frequency_hz))
        if not count:
            raise ValueError(f"{frequency_hz:g} Hz lies above the first mode of the model at "
                             f"{first_mode_hz:.4g} Hz: repetitive feedback needs one below it")
        self.frequencies_hz = frequency_hz * np.arange(1, count + 1)
        self._model, self._clock_period_s = model, clock_period_s
        self._angles = 2.0 * np.pi * self.frequencies_hz * clock_period_s
        plant, _ = design_plant(model, clock_period_s, clock_period_s, delay_ticks=0)
        self._points = np.exp(1j * self._angles)
        gain_um_per_v = nominal_hysteresis_gain(model)
        self._responses = gain_um_per_v * plant(self._points, squeeze=False)[0, 0]

    def controller(self, numbers: FloatArray) -> control.StateSpace:
        """Return the discrete controller of `NAMES` from error (um) to voltage (V)."""
        *of_pi, width = numbers
        pi = FORMS["pi"].controller(self._model, of_pi, self._clock_period_s)
        behind_pi = self._responses / (
            1.0 + self._responses * pi(self._points, squeeze=False)[0, 0])
        half_width = 2.0 * np.pi * width * self.frequencies_hz[0] * self._clock_period_s
        gains, leads = half_width / np.abs(behind_pi), -np.angle(behind_pi)
        radii = np.exp(-DAMPING_RATIO * self._angles)
        sums = 2.0 * radii * np.cos(self._angles)
        blocks = [np.array([[of_sum, -radius**2], [1.0, 0.0]])
                  for of_sum, radius in zip(sums, radii, strict=True)]
        # Realisation of g (cos(lead) z^2 - r cos(lead - angle) z) / (z^2 - 2 r cos(angle) z + r^2).
        direct = gains * np.cos(leads)
        outputs = np.column_stack([
            direct * sums - gains * radii * np.cos(leads - self._angles), -direct * radii**2])
        states = pi.nstates
        a = np.zeros((states + 2 * len(blocks),) * 2)
        a[:states, :states] = pi.A
        for number, block in enumerate(blocks):
            at = slice(states + 2 * number, states + 2 * number + 2)
            a[at, at] = block
        b = np.vstack([pi.B, np.tile([[1.0], [0.0]], (len(blocks), 1))])
        return control.ss(a, b, np.hstack([pi.C, outputs.reshape(1, -1)]),
                          pi.D + direct.sum(), self._clock_period_s)
