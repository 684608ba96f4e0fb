# SPDX-License-Identifier: BSD-3-Clause
"""Creep with a power or the logarithm of time: evenly spaced exponentials of two free numbers.

The gains of the exponentials are a power of their rates (as in Oustaloup et al., IEEE Trans.
Circuits Syst. I 47, 2000). A point contains the logarithms of rates, then of gains; gains are
relative to the immediate one.
"""

from typing import Any

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.settling import (
    RINGING,
    SLOWER_THAN_MODES,
    SlowDynamics,
)
from piezo_identification.estimators.estimate import creep_of_partial_fractions, propagated
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics

POWER_LAW = "power law"
"""Name of the order of such creep."""

RATIO = 4.0
"""Ratio of neighbouring rates: the response of their sum differs from a power of time by less than
1e-5 of the step."""

LARGEST_PART = 0.5
"""Largest part of the immediate gain that exponentials faster than the rows may take."""


def rates_of_law(bounds: FloatArray) -> FloatArray:
    """Return logarithms of rates that cover those which the rows show, and two slower ones.

    The bounds, (2,), are the logarithms of the slowest and the fastest rate that the rows show.
    """
    count = int(np.ceil(np.ptp(bounds) / np.log(RATIO))) + 2
    rates: FloatArray = bounds[1] - np.log(RATIO) * (np.arange(count, 0.0, -1.0) - 0.5)
    return rates


def of_level_and_exponent(rates: FloatArray, centre: float) -> FloatArray:
    """Return the change of a point with the level at a rate, and with the exponent, (P, 2)."""
    of_gains = np.column_stack([np.ones(rates.size), rates - centre])
    return np.concatenate([np.zeros_like(of_gains), of_gains])


def continued(point: FloatArray, end_rad_per_s: float) -> tuple[FloatArray, FloatArray]:
    """Continue a power law from the rates that the rows show to a faster one.

    A law whose gains increase with the rates ends earlier, before it takes the immediate gain.
    Return the continued point, (Q,), and its change with level and exponent, (Q, 2); for the last
    rate see `end_of_law_rad_per_s`.
    """
    rates, gains = np.split(point, 2)
    end = np.log(max(end_rad_per_s, np.exp(rates[-1])))
    faster = np.arange(rates[-1] + np.log(RATIO), end, np.log(RATIO))
    wider = np.append(rates, faster)
    all_gains = np.polyval(np.polyfit(rates, gains, 1), wider)
    # The faster exponentials were a part of the immediate gain.
    parts = np.cumsum(np.exp(all_gains[rates.size :]))
    parts = parts[parts <= LARGEST_PART]
    wider, all_gains = (each[: rates.size + parts.size] for each in (wider, all_gains))
    all_gains = all_gains - np.log1p(-parts[-1] if parts.size else 0.0)
    return np.concatenate([wider, all_gains]), of_level_and_exponent(wider, rates.mean())


def creep_of_point(
    point: FloatArray, free: FloatArray, covariance: FloatArray,
) -> tuple[CreepDynamics, dict[str, Any]]:
    """Return the creep of a point, (P,), and its standard deviations.

    `free`, (P, n), is the change of the point with each free number, whose covariance is (n, n).
    """
    values = np.exp(point)
    rates, gains = np.split(values, 2)
    return creep_of_partial_fractions(
        rates, gains, propagated(values[:, None] * free, covariance))


def end_of_law_rad_per_s(dynamics: ElectricVibrationDynamics | None,
                         highest_rad_per_s: float) -> float:
    """Return the rate up to which a power law is continued.

    It ends below the known modes that ring, or below the highest frequency of the fast recordings
    if none is known.
    """
    dynamics = dynamics or ElectricVibrationDynamics()
    parallel = dynamics.parallel_modes if isinstance(dynamics, SlowDynamics) else ()
    modes = [*zip(dynamics.mode_frequencies_rad_per_s, dynamics.damping_ratios, strict=True),
             *((mode.frequency_rad_per_s, mode.damping_ratio) for mode in parallel)]
    return SLOWER_THAN_MODES * min(
        (frequency for frequency, damping in modes if damping < RINGING), default=highest_rad_per_s)
