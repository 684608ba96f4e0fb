# SPDX-License-Identifier: BSD-3-Clause
"""Rules for bandwidth and rate of the feedback: (5.9) to (5.11) of the thesis."""

import math
from dataclasses import dataclass

# The thesis lies on the bound itself, and the ultimate frequency is no more accurate than this.
ON_THE_BOUND = 0.05

SUPPRESSION = 2.0
"""Least ratio of the feedback's bandwidth to that of the disturbances, ``gamma``."""


@dataclass(frozen=True)
class LoopRules:
    """Bounds within which the feedback is designed."""

    lowest_bandwidth_hz: float
    highest_bandwidth_hz: float
    """Bandwidth of the feedback, (5.9)."""
    lowest_rate_hz: float
    highest_rate_hz: float
    """Rate of the feedback, (5.10)."""
    samples_per_tick: int
    """Samples per tick at the chosen rate."""
    performance_hz: float
    robustness_hz: float
    """``omega_p`` and ``omega_s`` of (5.11) at that rate."""


def choose_rates(ultimate_hz: float, clock_hz: float, computing_s: float,
                 usual_samples_per_tick: int, disturbance_hz: float = 20.0) -> LoopRules:
    """Return the bounds of bandwidth and rate, and the rate to use; ValueError if there is none.

    The rate is the usual one if it is within its bounds; otherwise the slowest that is, since a
    high rate amplifies noise and costs computing time.

    Parameters
    ----------
    ultimate_hz : float
        Frequency at which a relay oscillates with the stage; used for ``omega_r`` and ``omega_bc``.
    clock_hz : float
        Rate of the stage's sample clock, f_max.
    computing_s : float
        Computing time of one answer of the feedback, T_FB.
    disturbance_hz : float
        Bandwidth of the disturbances, ``omega_d``.
    """
    performance_hz = SUPPRESSION * disturbance_hz
    highest_bandwidth_hz = min(clock_hz / 2, 1 / computing_s, ultimate_hz)
    if performance_hz >= highest_bandwidth_hz:
        raise ValueError(f"disturbances up to {disturbance_hz:g} Hz need a bandwidth of "
                         f"{performance_hz:g} Hz, but {highest_bandwidth_hz:.4g} Hz is the most: "
                         "lower the bandwidth of the disturbances")
    lowest_rate_hz = 2 * max(performance_hz, ultimate_hz, disturbance_hz)
    highest_rate_hz = min(clock_hz, 1 / computing_s)
    if lowest_rate_hz > highest_rate_hz:
        raise ValueError(f"the feedback must answer {lowest_rate_hz:.4g} times a second, but can "
                         f"{highest_rate_hz:.4g} times: lower the controller's order")
    samples_per_tick = usual_samples_per_tick
    usual_hz = clock_hz / usual_samples_per_tick
    if not (1 - ON_THE_BOUND) * lowest_rate_hz <= usual_hz <= highest_rate_hz:
        samples_per_tick = math.floor(clock_hz / lowest_rate_hz)
    rate_hz = clock_hz / samples_per_tick
    return LoopRules(performance_hz, highest_bandwidth_hz, lowest_rate_hz, highest_rate_hz,
                     samples_per_tick, performance_hz,
                     min(rate_hz / 2, 1 / computing_s, ultimate_hz))
