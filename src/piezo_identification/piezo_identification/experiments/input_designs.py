# SPDX-License-Identifier: BSD-3-Clause
"""Waveforms of the experiments: arcs, harmonics, multisines, and the diagnostic waveform."""

from collections.abc import Iterator
from itertools import pairwise

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
"""Seed of the omitted lines and of the phases, those of the tones among them."""

REST_S = 0.8
"""Time at rest, which shows noise, disturbances from outside, outliers and drift."""

LOOPS = (0.0, 1.0, 0.12, 0.78, 0.35, 0.61, 0.0, 0.93, 0.05, 0.5)
"""Turning points as fractions of the range: the major loop, loops within it, then the middle."""

ARC_S, DWELL_S = 0.1, 0.25
"""Durations of an arc from one turning point to the next and of the dwell there. They show
hysteresis, play, creep and, at the ends of the range, clipping."""

RATES_HZ, CYCLES, RATE_SWING = (4.0, 25.0, 150.0), (1, 5, 20), 0.16
"""Frequencies, cycles and amplitude (fraction of the range) of a loop about the middle. It is
repeated at rising rates, which shows rate dependence."""

STEPS = (0.3, -0.05, 0.1, -0.2, 0.05, -0.3, 0.2, -0.1) * 3

STEP_S = 0.025
"""Heights as fractions of the range, and duration of each: they show slewing, ringing, delay."""

TONES_HZ, TONES_S, TONE_SWINGS = (20.0, 3000.0), 1.0, (0.02, 0.07)
"""Band of the tones, their duration and their total RMS (fraction of the range), a small one and a
large one. They show modes, delay, lags and how these depend on the amplitude."""

TONES_PER_S = 10


def arc(start: float, end: float, samples: int) -> FloatArray:
    """Return half a cosine (samples,) from start to end, reached one sample after the last."""
    return start + 0.5 * (end - start) * (1.0 - np.cos(np.pi * np.arange(samples) / samples))


def stair_amplitudes(level_count: int, highest_v: float, below_the_top: float = 0.0) -> FloatArray:
    """Return L equally spaced amplitudes up to the highest voltage, (3.7), (4.7), (4.8).

    Each is lowered by a fraction of a step, 0.5 for (3.6).
    """
    return (np.arange(1, level_count + 1) - below_the_top) * highest_v / level_count


def stair_harmonics(
    time_s: FloatArray, amplitudes_v: FloatArray, harmonic_period_s: float,
) -> FloatArray:
    """Return harmonics from zero to each of the amplitudes in turn and back, (2.29), (3.6), (4.6).

    They are given at the times, (N,). The amplitudes, (L,), are repeated after L periods.
    """
    # Rounding must not put a whole number of periods into the period before.
    periods = np.asarray(time_s) / harmonic_period_s
    harmonic = np.floor(periods + 1e-9).astype(int) % len(amplitudes_v)
    return 0.5 * np.asarray(amplitudes_v)[harmonic] * (1.0 - np.cos(2.0 * np.pi * periods))


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

    Pintelon and Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., 4.3. Raise
    ValueError if the band holds too few lines.
    """
    random = np.random.default_rng(SEED)
    samples = round(period_s * limits.sample_rate_hz)
    highest = int(min(highest_hz, HIGHEST_OF_CLOCK * limits.sample_rate_hz) * period_s)
    if highest < 6 * GROUP:
        raise ValueError(f"experiment 'distortion' has {highest} lines up to its highest "
                         "frequency: make its period longer")
    wave = random_phase_multisine(excited_lines(highest, random), samples, random)
    step = np.abs(np.diff(np.append(wave, wave[:1]))).max()
    amplitude_v = min(swing * limits.span_v, limits.largest_step_v / step)
    return np.asarray(limits.middle_v + amplitude_v * wave)


def diagnostic_block(limits: StageLimits) -> FloatArray:
    """Return one block (N,), in V, from the lowest voltage back to it, at the sample clock.

    Raise ValueError if the sample clock is too slow for the fastest loop.
    """
    rate_hz = limits.sample_rate_hz
    if rate_hz <= 2.0 * max(RATES_HZ):
        raise ValueError(
            f"the diagnostic loops of up to {max(RATES_HZ):g} Hz need a sample clock of more than "
            f"{2.0 * max(RATES_HZ):g} Hz, the stage has {rate_hz:g} Hz: take a faster clock")
    # A step happens within one sample, and the slew limit may not allow the largest ones.
    highest_step = limits.slew_limit_v_per_s / rate_hz / limits.span_v
    parts = [
        np.zeros(round(REST_S * rate_hz)), *_loops(rate_hz), *_faster_and_faster(rate_hz),
        *_steps(rate_hz, highest_step), *_tones(rate_hz, highest_step),
        arc(0.5, 0.0, round(ARC_S * rate_hz)),
    ]
    return limits.voltage_min_v + limits.span_v * np.concatenate(parts)


def _loops(rate_hz: float) -> Iterator[FloatArray]:
    for start, end in pairwise(LOOPS):
        yield arc(start, end, round(ARC_S * rate_hz))
        yield np.full(round(DWELL_S * rate_hz), end)


def _faster_and_faster(rate_hz: float) -> Iterator[FloatArray]:
    for frequency_hz, cycles in zip(RATES_HZ, CYCLES, strict=True):
        samples = round(cycles / frequency_hz * rate_hz)
        phase = 2.0 * np.pi * cycles * np.arange(samples) / samples
        yield 0.5 + RATE_SWING * np.sin(phase)


def _steps(rate_hz: float, highest_step: float) -> Iterator[FloatArray]:
    samples = round(STEP_S * rate_hz)
    yield np.full(samples, 0.5)
    for step in STEPS:
        height = np.sign(step) * min(abs(step), highest_step)
        yield np.repeat([0.5 + height, 0.5], samples)


def _tones(rate_hz: float, highest_step: float) -> Iterator[FloatArray]:
    samples = round(TONES_S * rate_hz)
    highest_hz = min(TONES_HZ[1], HIGHEST_OF_CLOCK * rate_hz)
    lines = np.arange(TONES_HZ[0], highest_hz, TONES_PER_S) * TONES_S
    harmonics = np.zeros(samples // 2 + 1, dtype=complex)
    phases = np.random.default_rng(SEED).uniform(0.0, 2.0 * np.pi, lines.size)
    harmonics[np.round(lines).astype(int)] = np.exp(1j * phases)
    wave = np.fft.irfft(harmonics, samples)
    # Fade in and out, so that the ends excite no ringing.
    wave *= np.minimum(1.0, np.minimum(np.arange(samples), np.arange(samples)[::-1]) / (
        0.05 * rate_hz))
    wave /= wave.std()
    largest_swing = highest_step / np.abs(np.diff(wave)).max()
    for swing in TONE_SWINGS:
        yield 0.5 + min(swing, largest_swing) * wave
