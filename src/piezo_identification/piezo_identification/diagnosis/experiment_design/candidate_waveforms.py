# SPDX-License-Identifier: BSD-3-Clause
"""The families of waveforms from which an experiment is chosen.

Each family has two parameters: a level, the fraction of the voltage range that it uses, and a rate.
Slow waveforms last for the whole time allowed, with samples held for milliseconds; fast ones last
for a second or two at the sample clock.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.experiments.catalogue import Experiment
from piezo_identification.experiments.input_designs import random_phase_multisine
from piezo_identification.experiments.stage_limits import StageLimits

SLOW_SAMPLES = 30_000
"""Approximate number of samples of a slow waveform: what a diagnosis fits of one recording."""
ROUNDED = 41
"""Number of samples over which an edge of a slow waveform is smoothed."""
FAST_S = 2.0
FEWEST_SAMPLES = 1000
"""Rows of a fast waveform with a slow clock: twice what a comparison needs, as half may settle."""
FASTEST_OF_CLOCK = 0.1
"""Highest frequency relative to the sample rate: above it, a held voltage is too coarse."""
MOST_OF_RANGE = 0.95
SEED = 0
"""Seed for random levels and phases."""


@dataclass(frozen=True)
class Family:
    """A family of waveforms."""

    name: str

    levels: tuple[float, ...]
    """Fractions of the voltage range that are tried."""
    rates: tuple[float, ...]
    """Rates in Hz: the frequency of triangles, the number of steps per second, the highest
    frequency of multisines and sweeps."""
    fast: bool
    """Whether it is played at the sample clock."""
    shape: Callable[[FloatArray, float], FloatArray]
    """Returns the wave between -1 and 1 for time in s, shape (N,), and rate."""


def _triangles(time_s: FloatArray, rate_hz: float) -> FloatArray:
    """Triangles whose amplitude rises until the middle of the time and falls again."""
    triangle = 4.0 * np.abs((rate_hz * time_s + 0.25) % 1.0 - 0.5) - 1.0
    position = time_s / time_s[-1]
    return triangle * (0.1 + 0.9 * (1.0 - np.abs(2.0 * position - 1.0)))


def _steps(time_s: FloatArray, rate_hz: float) -> FloatArray:
    """Random levels, each held for a random time."""
    random = np.random.default_rng(SEED)
    count = max(2, round(rate_hz * time_s[-1]))
    holds = random.uniform(0.3, 1.7, count)
    edges_s = np.cumsum(holds)[:-1] * time_s[-1] / holds.sum()
    return random.uniform(-1.0, 1.0, count)[np.searchsorted(edges_s, time_s, side="right")]


def _rest_and_creep(time_s: FloatArray, rate_hz: float) -> FloatArray:
    """Rest, a step up and a rest, a step down and a rest: drift continues, creep restarts."""
    rate_hz = max(rate_hz, 1.0 / float(time_s[-1]))
    return np.where((rate_hz * time_s + 0.75) % 1.0 < 0.5, 1.0, -1.0) * np.where(
        rate_hz * time_s < 0.25, 0.0, 1.0)


def _sweep(time_s: FloatArray, highest_hz: float) -> FloatArray:
    """Sine with a frequency that rises over two and a half decades."""
    ratio, duration_s = np.log(300.0), time_s[-1]
    first_hz = highest_hz / 300.0
    return np.sin(2.0 * np.pi * first_hz * duration_s / ratio
                  * np.expm1(ratio * time_s / duration_s))


def _multisine(time_s: FloatArray, highest_hz: float) -> FloatArray:
    """Two periods of a multisine with all lines up to the highest frequency."""
    samples = time_s.size // 2
    period_s = samples * float(time_s[1] - time_s[0])
    lines = np.arange(1, max(2, round(highest_hz * period_s)) + 1)
    wave = random_phase_multisine(lines, samples, np.random.default_rng(SEED))
    return np.asarray(np.resize(wave, time_s.size))


FAMILIES = (
    Family("triangles", (0.3, 0.9), (0.2, 2.0), False, _triangles),
    Family("steps", (0.3, 0.8), (0.3, 2.0), False, _steps),
    Family("rest_and_creep", (0.3, 0.8), (0.035, 0.1), False, _rest_and_creep),
    Family("slow_sweep", (0.3, 0.9), (30.0,), False, _sweep),
    Family("fast_triangles", (0.2, 0.7), (20.0, 100.0), True, _triangles),
    Family("fast_steps", (0.1, 0.35), (50.0, 200.0), True, _steps),
    Family("sweep", (0.1, 0.4), (500.0, 3000.0), True, _sweep),
    Family("multisine", (0.2, 0.6), (300.0, 3000.0), True, _multisine),
)


def _rounded(wave: FloatArray) -> FloatArray:
    """Smooth the edges, so that fast errors of a model between slow samples do not matter."""
    window = np.hanning(ROUNDED + 2)[1:-1]
    padded = np.concatenate([np.full(ROUNDED // 2, wave[0]), wave,
                             np.full(ROUNDED - 1 - ROUNDED // 2, wave[-1])])
    return np.asarray(np.convolve(padded, window / window.sum(), mode="valid"))


@dataclass(frozen=True)
class Point:
    """One waveform of a family."""

    family: Family

    level: float
    """Fraction of the voltage range."""
    rate_hz: float
    """Reduced if the sample clock requires it."""

    def neighbours(self, factor: float) -> "list[Point]":
        """Return the points with the level or the rate multiplied or divided by a factor."""
        return [replace(self, level=min(MOST_OF_RANGE, self.level * factor)),
                replace(self, level=self.level / factor),
                replace(self, rate_hz=self.rate_hz * factor),
                replace(self, rate_hz=self.rate_hz / factor)]


def grid() -> list[Point]:
    """Return the points of all families on their grids."""
    return [Point(family, level, rate_hz) for family in FAMILIES for level in family.levels
            for rate_hz in family.rates]


def waveform(limits: StageLimits, longest_s: float, point: Point) -> Experiment:
    """Make a waveform as large as its level and the slew limit allow."""
    family = point.family
    clock_s = 1.0 / limits.sample_rate_hz
    period_s = clock_s
    if not family.fast:
        period_s = clock_s * max(1, round(longest_s / SLOW_SAMPLES / clock_s))
    fast_s = max(FAST_S, FEWEST_SAMPLES * clock_s)
    duration_s = min(longest_s, fast_s) if family.fast else longest_s
    time_s = period_s * np.arange(round(duration_s / period_s), dtype=np.float64)
    rate_hz = min(point.rate_hz, FASTEST_OF_CLOCK / period_s)
    wave = family.shape(time_s, rate_hz)
    if not family.fast:
        wave = _rounded(wave)
    largest_v = 0.99 * limits.slew_limit_v_per_s * clock_s
    step = float(np.abs(np.diff(wave)).max())
    amplitude_v = min(0.5 * point.level * limits.span_v, largest_v / max(step, 1e-12))
    return Experiment(
        f"{family.name}_{point.level:.3g}_{rate_hz:.4g}Hz",
        limits.clip(limits.middle_v + amplitude_v * wave), period_s, 1,
        f"{family.name.replace('_', ' ')} of {2.0 * amplitude_v:.3g} V, {rate_hz:.3g} Hz")
