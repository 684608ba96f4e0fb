# SPDX-License-Identifier: BSD-3-Clause
"""Classify the waveform of a voltage."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.signal import correlate
from scipy.stats import spearmanr

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.waveforms import REVERSAL, turning_points


class Kind(StrEnum):
    """Kinds of waveform."""

    CONSTANT = "constant"
    SQUARE = "square"
    STEPS = "steps"
    TRIANGLE = "triangle"
    SINE = "sine"
    CYCLES = "cycles"  # of changing amplitude, or with rests between
    MULTISINE = "multisine"
    NOISE = "noise"
    CHIRP = "chirp"

    @property
    def has_levels(self) -> bool:
        """Whether the voltage jumps between levels."""
        return self in (Kind.SQUARE, Kind.STEPS)

    @property
    def has_cycles(self) -> bool:
        """Whether the voltage goes up and down."""
        return self in (Kind.TRIANGLE, Kind.SINE, Kind.CYCLES)

    @property
    def is_broadband(self) -> bool:
        """Whether the voltage excites many frequencies."""
        return self in (Kind.MULTISINE, Kind.NOISE, Kind.CHIRP)


@dataclass(frozen=True)
class KindSettings:
    """Thresholds that distinguish the kinds of waveform."""

    constant: float = 1e-3
    """Largest swing of a constant voltage, as a fraction of the largest voltage."""
    level_width: float = 0.02
    """Width of a level, as a fraction of the swing."""
    held: float = 0.8
    """Smallest fraction of unchanged samples for a voltage with levels."""
    widest_level: float = 0.06
    widest_group: float = 0.5
    """Largest width of adjoining voltages that form one level, and that form levels at all, as
    fractions of the swing."""
    most_levels: int = 100

    even_slope: float = 0.2
    """Largest spread of the slopes over their median for a voltage made of ramps."""
    slopes_per_branch: int = 20
    """Number of slopes evaluated between two reversals."""
    one_tone: float = 0.9
    """Smallest fraction of the energy in one line of the spectrum for a sine."""
    even_branches: float = 0.15
    """Largest spread of the times between reversals over their median for regular cycles."""
    full_cycle: float = 0.6
    """Smallest median distance between reversals for cycles, as a fraction of the swing; in noise
    it is far shorter."""
    random_branches: float = 1.0
    """Smallest spread of the times between reversals over their median for which motion over the
    whole swing is noise of two levels."""
    most_cycles: int = 50
    """Most reversals for which such motion may be irregular cycles instead."""
    steady_order: float = 0.9
    """Smallest rank correlation of amplitudes, or of times between reversals, with their order for
    an amplitude that grows or shrinks, or for a chirp."""
    grown: float = 1.3
    """Smallest ratio of the first and last amplitude for one that grows or shrinks."""
    jump: float = 0.05
    jump_over_usual: float = 5.0
    jump_over_others: float = 2.0
    """Smallest change between two samples that is a jump: as a fraction of the swing, as a multiple
    of the 99 % quantile, and as a multiple of the largest other change."""
    chirp_ratio: float = 3.0
    """Smallest ratio of the first and last time between reversals, and of the slopes between them,
    for a chirp."""
    repeated: float = 0.97
    """Smallest autocorrelation of a periodic voltage."""
    sparse: float = 0.3
    """Largest fraction of the lines of the band that hold 95 % of the energy for a multisine."""
    most_samples: int = 1 << 20
    """Number of samples used for spectra; longer recordings are cut."""


SETTINGS = KindSettings()


@dataclass(frozen=True)
class Waveform:
    """The kind of a voltage."""

    kind: Kind

    text: str
    """Description as part of a sentence."""
    jumps: np.ndarray
    """Samples at which the voltage changes its level, or jumps during slow motion."""
    branch_s: float = np.inf
    """Median time between reversals or jumps; infinite if there are none."""
    period: int = 0
    """Period in samples; 0 if the voltage is not periodic."""


def waveform_of(voltage_v: FloatArray, period_s: float) -> Waveform:
    """Determine the kind of a voltage."""
    none = np.empty(0, dtype=np.intp)
    swing_v = float(np.ptp(voltage_v))
    if swing_v <= SETTINGS.constant * float(np.abs(voltage_v).max()):
        return Waveform(Kind.CONSTANT, f"{voltage_v.mean():.6g} V throughout", none)
    with_levels = _levels(voltage_v, swing_v, period_s)
    if with_levels:
        return with_levels
    part_v = voltage_v[: SETTINGS.most_samples]
    turns = turning_points(part_v, REVERSAL * swing_v)
    branches_s = np.diff(turns) * period_s
    branch_s = float(np.median(branches_s[1:-1] if branches_s.size > 2 else branches_s))
    heights = np.abs(np.diff(voltage_v[turns]))[1:-1] / swing_v
    spectrum = _spectrum(part_v, period_s)
    growth = _growth(_swings_of_tone(part_v, spectrum[0] * period_s)
                     if spectrum[1] > SETTINGS.one_tone else heights)
    period = 0 if growth else _repeat(part_v)
    kind, text = _kind_of_moving(
        part_v, period_s, branches_s[1:-1], branch_s, period, heights, spectrum, growth)
    jumps = none if kind.is_broadband else _lone_jumps(voltage_v, swing_v)
    if jumps.size:
        text += f", with {jumps.size} jump{'s' if jumps.size > 1 else ''}"
    return Waveform(kind, text, jumps, branch_s, period)


def _lone_jumps(voltage_v: FloatArray, swing_v: float) -> np.ndarray:
    """Return the samples at which a slowly moving voltage jumps.

    Jumps exceed all other changes clearly, unlike the largest steps of a dither.
    """
    change_v = np.abs(np.diff(voltage_v))
    usual_v = float(np.quantile(change_v, 0.99))
    least_v = max(SETTINGS.jump * swing_v, SETTINGS.jump_over_usual * usual_v)
    descending = np.append(np.sort(change_v)[::-1], 0.0)
    stand_out = (descending[:-1] > least_v) & (
        descending[:-1] > SETTINGS.jump_over_others * descending[1:])
    if not stand_out.any():
        return np.empty(0, dtype=np.intp)
    return np.flatnonzero(change_v >= descending[np.flatnonzero(stand_out)[-1]]) + 1


def _levels(voltage_v: FloatArray, swing_v: float, period_s: float) -> Waveform | None:
    """Return the waveform of a voltage that is held at levels; None for other voltages."""
    change_v = np.abs(np.diff(voltage_v))
    if np.mean(change_v <= SETTINGS.level_width * swing_v) < SETTINGS.held:
        return None
    level = np.round((voltage_v - voltage_v.min()) / (SETTINGS.level_width * swing_v))
    held = np.concatenate([[True], np.diff(level) == 0.0])
    # Noise at the edge between two bins would split one level into two.
    bins = np.unique(level[held])
    parts = np.split(bins, np.flatnonzero(np.diff(bins) > 1.5) + 1)
    groups = len(parts)
    widest = SETTINGS.level_width * max(1.0 + np.ptp(part) for part in parts)
    jumps = np.flatnonzero(change_v > 1.5 * SETTINGS.level_width * swing_v) + 1
    if jumps.size == 0 or not 2 <= groups <= SETTINGS.most_levels or (
            widest > SETTINGS.widest_group):
        return None
    inside = np.ones(change_v.size, dtype=bool)
    inside[jumps - 1] = False
    # A level is constant between jumps; a ramp or a sine is not.
    drifts = [np.ptp(part) for part in np.split(voltage_v, jumps) if part.size > 4]
    if not drifts or np.mean(np.array(drifts) < 3.0 * SETTINGS.level_width * swing_v) < 0.9:
        return None
    if sum(part.size for part in np.split(voltage_v, jumps)
           if part.size > 4) < 0.5 * voltage_v.size:
        return None
    rows = np.diff(np.concatenate([[0], jumps, [voltage_v.size]]))
    # A few rows between two levels are a transition, not a hold.
    branch_s = float(np.median(rows[rows > 4])) * period_s
    are_apart = widest <= 1.01 * SETTINGS.widest_level
    if groups == 2 and are_apart:
        count = "one step" if jumps.size == 1 else f"{jumps.size} steps"
        return Waveform(Kind.SQUARE, f"{count} between {voltage_v.min():.5g} and "
                        f"{voltage_v.max():.5g} V, held for {branch_s:.4g} s", jumps, branch_s)
    over = f" over {groups} levels" if are_apart else ""
    return Waveform(Kind.STEPS, f"{jumps.size} steps{over}, held for {branch_s:.4g} s", jumps,
                    branch_s)


def _repeat(voltage_v: FloatArray) -> int:
    """Return the period of a voltage in samples, apart from noise; 0 if it is not periodic."""
    varying_v = voltage_v - voltage_v.mean()
    size = varying_v.size
    products = correlate(varying_v, varying_v, method="fft")[size - 1 :]
    energy = np.concatenate([[0.0], np.cumsum(varying_v**2)])
    lags = np.arange(size // 2 + 1)
    scale = np.sqrt(energy[size - lags] * (energy[-1] - energy[lags]))
    alike = products[: lags.size] / np.maximum(scale, 1e-300)
    low = np.flatnonzero(alike < 0.5)
    if not low.size:
        return 0
    rest = alike[low[0] :]
    found = np.flatnonzero(rest > SETTINGS.repeated)
    if not found.size:
        return 0
    # Take the top of the first peak. With only two periods, it does not fall again.
    first = int(found[0])
    beyond = np.flatnonzero(rest[first:] < SETTINGS.repeated)
    end = first + int(beyond[0]) if beyond.size else rest.size
    return int(low[0]) + first + int(np.argmax(rest[first:end]))


def _kind_of_moving(voltage_v: FloatArray, period_s: float, branches_s: FloatArray,
                    branch_s: float, period: int, heights: FloatArray,
                    spectrum: tuple[float, float, float, float], growth: str) -> tuple[Kind, str]:
    frequency_hz, share, sparse, band_hz = spectrum
    again = f", repeated every {period * period_s:.4g} s" if period else ""
    # Slopes over many rows reduce the noise.
    stride = max(1, int(branch_s / period_s) // SETTINGS.slopes_per_branch)
    slopes = np.abs(voltage_v[stride:] - voltage_v[:-stride]) / stride
    low, middle, high = np.quantile(slopes, [0.1, 0.5, 0.9])
    if middle > 0.0 and high - low < SETTINGS.even_slope * middle:
        return Kind.TRIANGLE, (f"ramps of {middle / period_s:.4g} V/s, {branch_s:.4g} s between "
                            f"reversals{again}")
    mean_slopes = heights / branches_s
    if branches_s.size >= 6 and np.ptp(branches_s) > 0.0:
        order = abs(float(spearmanr(np.arange(branches_s.size), branches_s).statistic))
        if order > SETTINGS.steady_order and min(
                map(_first_over_last, (branches_s, mean_slopes))) > SETTINGS.chirp_ratio:
            first, last = branches_s[0], branches_s[-1]
            # Short times between reversals are coarse multiples of a row, so more are averaged.
            many = max(3, branches_s.size // 50)
            at_first, at_last = (3, many) if first > last else (many, 3)
            first, last = branches_s[:at_first].mean(), branches_s[-at_last:].mean()
            return Kind.CHIRP, f"{0.5 / first:.4g} to {0.5 / last:.4g} Hz"
    if share > SETTINGS.one_tone:
        if growth:
            return Kind.CYCLES, f"a sine of {frequency_hz:.4g} Hz whose amplitude {growth}"
        return Kind.SINE, f"{frequency_hz:.4g} Hz"
    if mean_slopes.size and np.ptp(np.quantile(mean_slopes, [0.1, 0.9])) < (
            SETTINGS.even_slope * np.median(mean_slopes)):
        # Cycles of growing amplitude take longer, too, but are not a chirp.
        slope_v = np.median(mean_slopes) * np.ptp(voltage_v)
        return Kind.CYCLES, (
            f"{slope_v:.4g} V/s in steps, {branch_s:.4g} s between reversals{again}")
    spread = np.ptp(np.quantile(branches_s, [0.1, 0.9])) if branches_s.size else 0.0
    full = heights.size > 0 and float(np.median(heights)) > SETTINGS.full_cycle
    telegraph = (branches_s.size > SETTINGS.most_cycles
                 and spread > SETTINGS.random_branches * branch_s)
    if full and not telegraph or spread <= SETTINGS.even_branches * branch_s:
        return Kind.CYCLES, f"{branch_s:.4g} s between reversals, of no single sine{again}"
    if period or sparse < SETTINGS.sparse:
        return Kind.MULTISINE, f"up to {band_hz:.4g} Hz{again}"
    return Kind.NOISE, f"up to {band_hz:.4g} Hz"


def _swings_of_tone(voltage_v: FloatArray, frequency: float) -> FloatArray:
    """Return the swing of each whole period of a tone with a frequency in cycles per row."""
    # A single swing has its strongest line at frequency 0.
    rows = max(1, round(1.0 / frequency)) if frequency else voltage_v.size
    whole = voltage_v[: voltage_v.size // rows * rows].reshape(-1, rows)
    return np.ptp(whole, axis=1)


def _growth(heights: FloatArray) -> str:
    """Return "grows" or "shrinks" if the swings do so throughout; empty otherwise."""
    if heights.size < 4 or _first_over_last(heights) < SETTINGS.grown:
        return ""
    order = float(spearmanr(np.arange(heights.size), heights).statistic)
    if abs(order) < SETTINGS.steady_order:
        return ""
    return "grows" if order > 0.0 else "shrinks"


def _first_over_last(values: FloatArray) -> float:
    """Return the ratio of the median first and last three values, inverted if it is below 1."""
    least, most = sorted((float(np.median(values[:3])), float(np.median(values[-3:]))))
    return most / least if least else np.inf


def _spectrum(voltage_v: FloatArray, period_s: float) -> tuple[float, float, float, float]:
    """Return the strongest line (Hz), its fraction of the energy, the sparsity, and the band (Hz).

    The band holds 99 % of the energy. The sparsity is the fraction of its lines that hold 95 %.
    """
    window = np.hanning(voltage_v.size)
    energy = np.abs(np.fft.rfft((voltage_v - voltage_v.mean()) * window)) ** 2
    total = energy.sum()
    top = int(np.argmax(energy))
    share = energy[max(top - 2, 0) : top + 3].sum() / total
    edge = int(np.searchsorted(np.cumsum(energy), 0.99 * total)) + 1
    ordered = np.cumsum(np.sort(energy[:edge])[::-1])
    sparse = (int(np.searchsorted(ordered, 0.95 * total)) + 1) / edge
    step_hz = 1.0 / (voltage_v.size * period_s)
    return top * step_hz, float(share), sparse, edge * step_hz
