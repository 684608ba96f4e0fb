# SPDX-License-Identifier: BSD-3-Clause
"""Even and odd distortion from multisines of the same odd lines with other phases each time.

The robust method of Pintelon and Schoukens, System Identification: A Frequency Domain Approach,
2nd ed., 4.3.1, with one period of each realisation: what answers to the voltage in the same way
each time is linear; the rest at odd lines is odd distortion and noise, and all at even lines is
even distortion and noise.
"""

from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.analysis.nonlinear_distortion import EXCITED

FEWEST_REALISATIONS = 3

LARGEST_EVEN = 0.1
"""Voltage of a typical even line over that of an odd one: above, even lines are excited."""


@dataclass(frozen=True)
class RealisationDistortion:
    """Best linear approximation of a stage, and the distortion beside it, line by line.

    Parameters
    ----------
    frequency_hz : ndarray, shape (L,)
        Of the excited lines, all odd.
    gain : ndarray of complex, shape (L,)
        Best linear approximation.
    answer_um, odd_um : ndarray, shape (L,)
        RMS over the realisations of the amplitude of the answer, and of what the gain leaves.
    even_um : ndarray, shape (L,)
        RMS amplitude at the even line below each.
    """

    frequency_hz: FloatArray
    gain: ComplexArray
    answer_um: FloatArray
    odd_um: FloatArray
    even_um: FloatArray

    @property
    def odd_percent(self) -> float:
        """Odd distortion with the noise, RMS over the answer."""
        return float(100.0 * np.sqrt(np.sum(self.odd_um**2) / np.sum(self.answer_um**2)))

    @property
    def even_percent(self) -> float:
        """Even distortion with the noise, RMS over the answer."""
        return float(100.0 * np.sqrt(np.sum(self.even_um**2) / np.sum(self.answer_um**2)))


def realisation_distortion(voltage_v: FloatArray, displacement_um: FloatArray,
                           sample_period_s: float) -> RealisationDistortion:
    """Separate the linear answer, even and odd distortion of several realisations.

    Parameters
    ----------
    voltage_v, displacement_um : ndarray, shape (R, N)
        A settled period of each realisation.

    Raises
    ------
    ValueError
        If there are too few realisations, or the voltage excites even lines.
    """
    count, samples = voltage_v.shape
    if count < FEWEST_REALISATIONS:
        raise ValueError(f"{count} realisations are given: give at least {FEWEST_REALISATIONS}, "
                         "as odd distortion is what differs between them")
    inputs = 2.0 * np.fft.rfft(voltage_v)[:, 1:] / samples
    outputs = 2.0 * np.fft.rfft(displacement_um)[:, 1:] / samples
    sizes = np.sqrt(np.mean(np.abs(inputs) ** 2, axis=0))
    lines = np.flatnonzero(sizes[::2] > EXCITED * sizes.max())
    # A line of mains in the voltage is no excitation.
    if np.median(sizes[1::2][: lines[-1]]) > LARGEST_EVEN * np.median(sizes[::2][lines]):
        raise ValueError("the voltage excites even lines: give multisines of odd lines")
    odd_in, odd_out = inputs[:, ::2][:, lines], outputs[:, ::2][:, lines]
    gain = np.sum(odd_out * odd_in.conj(), axis=0) / np.sum(np.abs(odd_in) ** 2, axis=0)
    left = np.sum(np.abs(odd_out - gain * odd_in) ** 2, axis=0) / (count - 1)
    # Before line 2k+1 lies the even line 2k; there is none below the first.
    below = outputs[:, 1::2][:, np.maximum(lines - 1, 0)]
    direct = gain * inputs[:, 1::2][:, np.maximum(lines - 1, 0)]
    even = np.where(lines > 0, np.mean(np.abs(below - direct) ** 2, axis=0), 0.0)
    return RealisationDistortion(
        (2 * lines + 1) / (samples * sample_period_s), gain,
        np.sqrt(np.mean(np.abs(odd_out) ** 2, axis=0)), np.sqrt(left), np.sqrt(even))
