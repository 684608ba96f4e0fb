# SPDX-License-Identifier: BSD-3-Clause
"""Locate a residual in frequency, time and voltage."""

import numpy as np
from scipy.signal import detrend, periodogram

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.adequacy.component_residual import ComponentResidual
from piezo_identification.adequacy.lack_of_fit import LackOfFit

BINS = 10
"""Number of bins of the recording time, of the time after a step, and of the voltage."""

NARROW = 1.5
"""Ratio of the band limits of the middle half of the power below which it is a single peak."""

MIDDLE_HALF = (0.25, 0.75)
"""Quantiles of the power at the limits of the reported band."""

LOPSIDED = 2.0
"""Ratio of the mean squares for rising and falling voltage above which the direction is named."""


def residual_location(
    residual: ComponentResidual, fit: LackOfFit,
) -> tuple[tuple[float, float], str]:
    """Find the frequencies, times and voltages at which a residual is largest.

    Return the band that contains the middle half of its power, in Hz, and a description.
    """
    values_um = fit.sequence_um
    if residual.frequency_hz is None:
        band_hz = _band(*periodogram(detrend(values_um, type="constant"),
                                     1.0 / residual.sample_period_s))
    else:
        order = np.argsort(residual.frequency_hz, kind="stable")
        band_hz = _band(residual.frequency_hz[order], residual.residual_um[order] ** 2)
    narrow = band_hz[1] < NARROW * band_hz[0]
    words = [f"near {_hertz(np.sqrt(band_hz[0] * band_hz[1]))} Hz" if narrow
             else f"from {_hertz(band_hz[0])} to {_hertz(band_hz[1])} Hz"]
    if residual.frequency_hz is None:
        words.append(_time_words(residual, values_um))
        if not residual.steps.size:
            words[-1] += f" and {_voltage_words(residual, values_um)}"
    return band_hz, ", ".join(words)


def _band(frequency_hz: FloatArray, power: FloatArray) -> tuple[float, float]:
    """Return the band of the middle half of the power."""
    share = np.cumsum(power) / max(np.sum(power), np.finfo(float).tiny)
    low, high = np.interp(MIDDLE_HALF, share, frequency_hz)
    return float(low), float(high)


def _time_words(residual: ComponentResidual, values_um: FloatArray) -> str:
    samples = np.arange(values_um.size)
    good = residual.good[: values_um.size]
    if residual.steps.size:
        steps = np.unique(residual.steps % (residual.period or values_um.size + 1))
        steps = steps[steps < values_um.size]
        # Samples before the first step follow the last step of the previous period.
        since = samples - np.concatenate([[steps[-1] - values_um.size], steps])[
            np.searchsorted(steps, samples, side="right")]
        seconds = np.maximum(since, 1) * residual.sample_period_s
        edges = np.geomspace(seconds.min(), seconds.max() * (1.0 + 1e-9), BINS + 1)
        low_s, high_s = _largest_bin(seconds, values_um, good, edges)
        return f"most of it {_time(low_s)} to {_time(high_s)} after the steps"
    seconds = samples * residual.sample_period_s + residual.time_s[0]
    low_s, high_s = _largest_bin(
        seconds, values_um, good, np.linspace(seconds[0], seconds[-1], BINS + 1))
    return f"most of it at {low_s:.4g} to {high_s:.4g} s"


def _voltage_words(residual: ComponentResidual, values_um: FloatArray) -> str:
    good = residual.good[: values_um.size]
    voltage_v = residual.voltage_v[: values_um.size]
    low_v, high_v = _largest_bin(
        voltage_v, values_um, good, np.linspace(voltage_v.min(), voltage_v.max(), BINS + 1))
    words = f"{low_v:.4g} to {high_v:.4g} V"
    slope = np.gradient(voltage_v)
    squares = [float(np.mean(values_um[part] ** 2)) if part.any() else 0.0
               for part in (good & (slope > 0.0), good & (slope < 0.0))]
    if min(squares) and max(squares) > LOPSIDED * min(squares):
        words += " where the voltage " + ("rises" if squares[0] > squares[1] else "falls")
    return words


def _largest_bin(
    place: FloatArray, values_um: FloatArray, good: BoolArray, edges: FloatArray,
) -> tuple[float, float]:
    """Return the edges of the bin with the largest mean square."""
    number = np.clip(np.searchsorted(edges, place, side="right") - 1, 0, edges.size - 2)[good]
    counts = np.bincount(number, minlength=edges.size - 1)
    squares = np.bincount(number, values_um[good] ** 2, minlength=edges.size - 1)
    largest = int(np.argmax(squares / np.maximum(counts, 1)))
    return float(edges[largest]), float(edges[largest + 1])


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms" if seconds < 1.0 else f"{seconds:.3g} s"


def _hertz(value: float) -> str:
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"
