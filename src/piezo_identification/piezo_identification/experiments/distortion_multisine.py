# SPDX-License-Identifier: BSD-3-Clause
"""A multisine that separates noise, even distortion and odd distortion without a model."""

import numpy as np

from piezo_common.arrays import FloatArray, IntArray
from piezo_identification.experiments.stage_limits import StageLimits

HIGHEST_OF_CLOCK = 0.1
"""Highest excited frequency over the sample rate. Above it, the held voltage is a coarse
staircase."""

GROUP = 3
"""Number of consecutive odd lines of which one is not excited; that line shows odd distortion."""

CREST_DRAWS = 32
"""Number of random phase sets; the one with the lowest crest factor is used."""

SEED = 0
"""Seed of the omitted lines and of the phases."""


def excited_lines(highest_line: int, random: np.random.Generator) -> IntArray:
    """Draw the increasing lines of a random odd multisine, omitting one of each group."""
    odd = np.arange(1, highest_line + 1, 2)
    left_out = [begin + random.integers(min(GROUP, odd.size - begin))
                for begin in range(0, odd.size, GROUP)]
    return np.delete(odd, left_out)


def random_phase_multisine(lines: IntArray, samples: int,
                           random: np.random.Generator) -> FloatArray:
    """Return one period (N,) of equal tones with random phases, scaled to a peak of 1."""
    best = np.zeros(samples)
    least = np.inf
    for _ in range(CREST_DRAWS):
        spectrum = np.zeros(samples // 2 + 1, dtype=complex)
        spectrum[lines] = np.exp(2j * np.pi * random.uniform(size=lines.size))
        wave = np.fft.irfft(spectrum, samples)
        crest = np.abs(wave).max() / wave.std()
        if crest < least:
            best, least = wave / np.abs(wave).max(), crest
    return best


def distortion_period(limits: StageLimits, swing: float, period_s: float,
                      highest_hz: float) -> FloatArray:
    """Return one period (N,) of the multisine around mid-range, at the sample clock.

    Pintelon and Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., 4.3.

    Raises
    ------
    ValueError
        If the band holds too few lines.
    """
    random = np.random.default_rng(SEED)
    samples = round(period_s * limits.sample_rate_hz)
    highest = int(min(highest_hz, HIGHEST_OF_CLOCK * limits.sample_rate_hz) * period_s)
    if highest < 6 * GROUP:
        raise ValueError(f"experiment 'distortion' has {highest} lines up to its highest "
                         "frequency: make its period longer")
    wave = random_phase_multisine(excited_lines(highest, random), samples, random)
    largest_v = 0.99 * limits.slew_limit_v_per_s / limits.sample_rate_hz
    step = np.abs(np.diff(np.append(wave, wave[:1]))).max()
    amplitude_v = min(swing * limits.span_v, largest_v / step)
    return np.asarray(limits.middle_v + amplitude_v * wave)
