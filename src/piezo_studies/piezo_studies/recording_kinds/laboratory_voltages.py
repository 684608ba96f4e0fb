# SPDX-License-Identifier: BSD-3-Clause
"""Voltages used in laboratories: every kind for each experiment, from 0 to 100 V."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezo_common.arrays import FloatArray

SLOW_S, LOOPS_S, POINTS_S, QUICK_S, FAST_S, MIXED_S = 0.05, 0.01, 1.0, 2e-4, 5e-5, 5e-4
"""Row periods (s) of creep, loops, static points, fast cycles, dynamics and validation."""

FAST_ROWS = 40_000
CREEP_ROWS = 4800
HOLD_ROWS = 4
"""Rows for which a noise generator holds each value."""

FINER = 8
"""Steps within a row at which a free-running generator may switch."""

GENERATOR_STEPS, STEPS_GONE = 4821, 1495
"""Steps in a period of that generator, and steps elapsed when the recording begins. As the number
of steps in a period is odd, edges occur at every step within a row."""


@dataclass(frozen=True)
class Played:
    """A voltage, row by row."""

    period_s: float
    """Period of the rows."""
    voltage_v: FloatArray
    """Voltage in steps that are `finer` times shorter than the rows, (N,)."""
    lead_rows: int = 0
    """Number of rows at the beginning that are played but not recorded."""
    finer: int = 1


def _held(levels_v: list[float], rows: int, first_rows: int) -> FloatArray:
    return np.append(np.full(first_rows, float(levels_v[0])), np.repeat(levels_v[1:], rows))


def _through(points: list[tuple[float, float]], period_s: float) -> FloatArray:
    """Return straight lines between points of time and voltage."""
    times_s, levels_v = np.array(points).T
    return np.interp(np.arange(0.0, times_s[-1], period_s), times_s, levels_v)


def _triangles(peaks_v: list[float], volts_per_s: float, period_s: float) -> FloatArray:
    """Return ramps from 0 V to each of the peaks and troughs in turn."""
    turns_v = np.append(0.0, peaks_v)
    times_s = np.append(0.0, np.cumsum(np.abs(np.diff(turns_v)) / volts_per_s))
    return np.interp(np.arange(0.0, times_s[-1], period_s), times_s, turns_v)


def _fast_time_s() -> FloatArray:
    return FAST_S * np.arange(FAST_ROWS, dtype=float)


def _free_square() -> Played:
    # The generator is not synchronized with the rows, so its edges lie between them. Its period is
    # a whole number of steps, as rounding would add jitter.
    steps = (STEPS_GONE + np.arange(FINER * FAST_ROWS)) % GENERATOR_STEPS
    return Played(FAST_S, np.where(2 * steps < GENERATOR_STEPS, 65.0, 35.0), finer=FINER)


def _chirp() -> Played:
    time_s = _fast_time_s()
    swept = 2.0 * time_s + 0.5 * (2500.0 - 2.0) / time_s[-1] * time_s**2
    return Played(FAST_S, 50.0 + 10.0 * np.sin(2.0 * np.pi * swept))


def _multisine() -> Played:
    lines = np.arange(1, 126, 2) * 20.0
    phases = np.random.default_rng(11).uniform(0.0, 2.0 * np.pi, lines.size)
    period = np.sin(2.0 * np.pi * np.outer(np.arange(1000) * FAST_S, lines) + phases).sum(axis=1)
    # The recorder is started by hand, in the middle of a period.
    return Played(FAST_S, 50.0 + 2.0 * np.tile(period, 50)[:FAST_ROWS], 4337)


def _noise() -> Played:
    values = np.random.default_rng(12).normal(size=FAST_ROWS // HOLD_ROWS)
    return Played(FAST_S, np.clip(50.0 + 10.0 * np.repeat(values, HOLD_ROWS), 0.0, 100.0))


def _fast_steps() -> Played:
    levels_v = np.random.default_rng(13).uniform(20.0, 80.0, 25).round()
    return Played(FAST_S, _held([50.0, *levels_v], 1500, 2500))


def _cycles() -> Played:
    time_s = QUICK_S * np.arange(12_000)
    amplitude_v = 10.0 * (1.0 + np.floor(time_s / 0.24))
    return Played(QUICK_S, 0.5 * amplitude_v * (1.0 - np.cos(2.0 * np.pi * time_s / 0.08)))


def _nested() -> list[float]:
    return [100.0, 0.0, *(level for top in range(90, 0, -10) for level in (100.0, 100.0 - top)),
            100.0, 0.0]


def _slow_record() -> Played:
    time_s = SLOW_S * np.arange(CREEP_ROWS)
    return Played(SLOW_S, 50.0 + 30.0 * np.sin(2.0 * np.pi * 0.013 * time_s - 1.0)
                  + 15.0 * np.sin(2.0 * np.pi * 0.047 * time_s + 1.0))


CREEP: dict[str, Callable[[], Played]] = {
    "square wave": lambda: Played(SLOW_S, _held([20.0, 80.0, 20.0, 80.0, 20.0, 80.0], 800, 800)),
    "steps": lambda: Played(SLOW_S, _held([0.0, 60.0, 20.0, 100.0, 0.0], 1100, 400)),
    "trapezoids": lambda: Played(SLOW_S, _through(
        [(0, 0), (10, 0), (15, 80), (65, 80), (70, 10), (120, 10), (125, 90), (175, 90), (180, 0),
         (240, 0)], SLOW_S)),
    "staircase": lambda: Played(SLOW_S, _held(
        [*range(0, 101, 10), *range(90, -1, -10)], 228, 240)),
    "slow motion": _slow_record,
}
DYNAMICS: dict[str, Callable[[], Played]] = {
    "free-running square wave": _free_square,
    "chirp": _chirp,
    "multisine": _multisine,
    "noise": _noise,
    "steps": _fast_steps,
}
HYSTERESIS: dict[str, Callable[[], Played]] = {
    "nested triangles": lambda: Played(LOOPS_S, _triangles(_nested(), 40.0, LOOPS_S)),
    "static points": lambda: Played(POINTS_S, _triangles(
        [100.0, 0.0, 80.0, 20.0, 60.0, 40.0, 50.0], 10.0, POINTS_S)),
    "fast cycles": _cycles,
}
KINDS = {"creep": CREEP, "dynamics": DYNAMICS, "hysteresis": HYSTERESIS}
"""Kinds of voltage by experiment; the first of each is the usual one."""


def validation() -> Played:
    """Return an unseen motion: slow and fast sines with jumps."""
    time_s = MIXED_S * np.arange(20_000)
    jumps_v = np.repeat([0.0, 12.0, -15.0, 6.0, -4.0], 4000)
    swept_v = 25.0 * np.sin(2.0 * np.pi * 0.43 * time_s) + 5.0 * np.sin(2.0 * np.pi * 17.3 * time_s)
    return Played(MIXED_S, 50.0 + jumps_v + swept_v
                  + 2.0 * np.sin(2.0 * np.pi * 90.0 * time_s + 1.0))
