# SPDX-License-Identifier: BSD-3-Clause
"""Initial guess of a mode that one axis drives, from the errors of a model."""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize
from scipy.signal.windows import hann

from piezo_common.arrays import FloatArray
from piezo_identification.axes.axis_effects import DAMPING_RATIOS, ModeOfAxis, held_mode
from piezo_recorder.reading.axes import AxesRecording

FEWEST_PERIODS = 10.0
"""Periods of a mode in a recording, below which it is a slow error and not a resonance."""

HIGHEST = 0.8
"""Highest frequency of a mode as a fraction of the Nyquist frequency, near which a held voltage has
no power."""

SPACING, GUESSED_DAMPING = 0.03, 0.03
"""Relative distance of the frequencies that are tried, which is as wide as a mode of this damping
ratio. The best one is refined."""

BAND = 2.0
"""Ratio of the mode's frequency and the lines on either side that are compared: beyond, it moves as
a gain does, or not at all."""


def guessed(mode: ModeOfAxis, driven: AxesRecording, residual_um: FloatArray,
            tolerance_um: FloatArray, delays_s: FloatArray) -> ModeOfAxis:
    """Return a mode with the values that explain most of the errors of a model.

    Parameters
    ----------
    driven : AxesRecording
        With the drive of the modes in place of the voltage.
    residual_um : (N, n) array
        Errors of the model.
    tolerance_um : (n,) array
        Standard deviation of the errors of each sensor without the mode.
    delays_s : (n,) array
        Delay of each sensor.
    """
    samples, period_s = len(residual_um), driven.sample_period_s
    drive_v = driven.voltage_v[:, driven.axes.index(mode.axis)]
    window = hann(samples, sym=False)
    drive = np.fft.rfft(window * (drive_v - drive_v.mean()))[:, None]
    errors = np.fft.rfft(window[:, None] * residual_um, axis=0)
    rates = 2.0 * np.pi * np.fft.rfftfreq(samples, period_s)

    def gains(frequency: float, damping: float) -> tuple[FloatArray, float]:
        """Return the static gains that fit best, (n,), and the squares that they explain."""
        lines = slice(*np.searchsorted(rates, (frequency / BAND, frequency * BAND)))
        turns = 1j * rates[lines, None]
        pole, residue = held_mode(frequency, damping, period_s)
        z, step = np.exp(turns * period_s), np.exp(pole * period_s)
        motion = drive[lines] * np.exp(-turns * delays_s) * (
            residue / (z - step) + residue.conjugate() / (z - step.conjugate()))
        power = np.maximum(np.sum(np.abs(motion) ** 2, axis=0), np.finfo(float).tiny)
        fitted: FloatArray = np.sum(motion.conj() * errors[lines], axis=0).real / power
        return fitted, float(np.sum(fitted**2 * power / tolerance_um**2))

    lowest, highest = 2.0 * np.pi * FEWEST_PERIODS / (samples * period_s), HIGHEST * rates[-1]
    tried = np.exp(np.arange(np.log(lowest), np.log(highest), SPACING))
    best = max(tried, key=lambda each: gains(each, GUESSED_DAMPING)[1])
    start = np.log([best, GUESSED_DAMPING])
    frequency, damping = np.exp(minimize(
        lambda logarithms: -gains(*np.exp(logarithms))[1], start, method="Nelder-Mead",
        bounds=[np.log([lowest, highest]), np.log(DAMPING_RATIOS)],
        options={"initial_simplex": start + [[0.0, 0.0], [SPACING, 0.0], [0.0, -1.0]]}).x)
    return replace(mode, guess=(float(frequency), float(damping),
                                *gains(frequency, damping)[0].tolist()))
