# SPDX-License-Identifier: BSD-3-Clause
"""Initial guess of a mode that one axis drives, from the errors of a model."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.signal.windows import hann

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.axes.axis_effects import DAMPING_RATIOS, ModeOfAxis, held_mode

FEWEST_PERIODS = 10.0
"""Periods of a mode in a recording, below which it is a slow error and not a resonance."""

HIGHEST = 0.8
"""Highest frequency of a mode as a fraction of the Nyquist frequency, near which a held voltage has
no power."""

GUESSED_DAMPING = 0.03
"""Damping ratio of the modes that are tried, and the relative distance of their frequencies, which
is as wide as such a mode. The best one is refined."""

BAND = 2.0
"""Ratio of the mode's frequency and the lines on either side that are compared: beyond, it moves as
a gain does, or not at all."""


@dataclass(frozen=True, eq=False)
class ErrorLines:
    """Errors of a model, and the drive of one axis, at lines of a spectrum."""

    rates: FloatArray
    """Angular frequencies, (K,)."""
    drive: ComplexArray
    """Shape (K,)."""
    errors: ComplexArray
    tolerance: FloatArray
    """Standard deviation of the errors of each sensor without the mode, (K, n)."""
    lowest: float
    """Lowest frequency of a mode in rad/s."""


def lines_of(drive_v: FloatArray, errors_um: FloatArray, tolerance_um: FloatArray,
             sample_period_s: float) -> ErrorLines:
    """Return the lines of a recording with the drive of one axis, (N,), and errors, (N, n).

    The tolerance, (n,), is the standard deviation of the errors of each sensor.
    """
    samples = len(errors_um)
    window = hann(samples, sym=False)
    drive = np.fft.rfft(window * (drive_v - drive_v.mean()))
    errors = np.fft.rfft(window[:, None] * errors_um, axis=0)
    return ErrorLines(
        np.asarray(2.0 * np.pi * np.fft.rfftfreq(samples, sample_period_s), float), drive, errors,
        np.tile(tolerance_um, (drive.size, 1)),
        2.0 * np.pi * FEWEST_PERIODS / (samples * sample_period_s))


def guessed(mode: ModeOfAxis, sample_period_s: float, lines: ErrorLines,
            delays_s: FloatArray) -> ModeOfAxis:
    """Return a mode with the values that explain most of a model's errors; the delays are (n,)."""

    def gains(frequency: float, damping: float) -> tuple[FloatArray, float]:
        """Return the static gains that fit best, (n,), and the squares that they explain."""
        near = slice(*np.searchsorted(lines.rates, (frequency / BAND, frequency * BAND)))
        turns = 1j * lines.rates[near, None]
        pole, residue = held_mode(frequency, damping, sample_period_s)
        z, step = np.exp(turns * sample_period_s), np.exp(pole * sample_period_s)
        tolerance = lines.tolerance[near]
        motion = lines.drive[near, None] / tolerance * np.exp(-turns * delays_s) * (
            residue / (z - step) + residue.conjugate() / (z - step.conjugate()))
        power = np.maximum(np.sum(np.abs(motion) ** 2, axis=0), np.finfo(float).tiny)
        pull = np.sum(motion.conj() * lines.errors[near] / tolerance, axis=0).real
        fitted: FloatArray = pull / power
        return fitted, float(np.sum(fitted**2 * power))

    lowest, highest = lines.lowest, min(lines.rates[-1], HIGHEST * np.pi / sample_period_s)
    tried = np.exp(np.arange(np.log(lowest), np.log(highest), GUESSED_DAMPING))
    best = max(tried, key=lambda each: gains(each, GUESSED_DAMPING)[1])
    start = np.log([best, GUESSED_DAMPING])
    frequency, damping = np.exp(minimize(
        lambda logarithms: -gains(*np.exp(logarithms))[1], start, method="Nelder-Mead",
        bounds=[np.log([lowest, highest]), np.log(DAMPING_RATIOS)],
        options={"initial_simplex": start + [[0.0, 0.0], [GUESSED_DAMPING, 0.0], [0.0, -1.0]]}).x)
    return replace(mode, guess=(float(frequency), float(damping),
                                *gains(frequency, damping)[0].tolist()))
