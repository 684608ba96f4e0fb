# SPDX-License-Identifier: BSD-3-Clause
"""A planned path with feedback: what the stage plays and expects, and the law that it evaluates."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from piezo_client.scan_learning import SAME_PERIOD, smooth_rise
from piezo_client.scans import MAX_FEEDBACK_V, StoredScan
from piezo_common.arrays import FloatArray
from piezo_models.feedback_law.axes_law import AxesLaw
from piezo_models.feedback_law.feedback_law import FeedbackLaw

REST_S = 0.1
"""Time at the first voltage before a path begins: many decays of the modes."""


class FollowedScan(NamedTuple):
    """A run of the stage along a path."""

    once_voltage_v: FloatArray
    """The way from rest into the path, (B, n)."""
    period_voltage_v: FloatArray
    """One period, which is repeated, (N, n)."""
    law: FeedbackLaw
    """Acts from the first period on."""
    samples: int
    """Duration until the last period is over, in whole ticks."""
    ticks: int


def followed_scan(scan: StoredScan, law: AxesLaw, periods: int, rest_voltage_v: ArrayLike,
                  ramp_rate_v_per_s: ArrayLike,
                  max_feedback_v: float = MAX_FEEDBACK_V) -> FollowedScan:
    """Return the run that follows a planned path with a feedback.

    Parameters
    ----------
    rest_voltage_v, ramp_rate_v_per_s : (n,) array_like
        Voltage of each axis at rest, and the rate at which it approaches the path.
    max_feedback_v : float
        Largest voltage of the feedback of each axis, of either sign (V).

    Raises
    ------
    ValueError
        If the law has other axes than the scan, or another sample period.
    """
    if law.axes != scan.axes or abs(law.sample_period_s / scan.sample_period_s - 1) > SAME_PERIOD:
        raise ValueError(
            f"the law is of the axes {', '.join(law.axes)} at {1.0 / law.sample_period_s:.6g} Hz, "
            f"the scan of {', '.join(scan.axes)} at {1.0 / scan.sample_period_s:.6g} Hz: design "
            "the law for the model that the scan was planned with")
    way_v = scan.begin_voltage_v[0] - np.asarray(rest_voltage_v)
    ramp_s = float(np.max(np.abs(way_v) / np.asarray(ramp_rate_v_per_s)))
    ramp = np.linspace(0.0, 1.0, math.ceil(ramp_s / law.sample_period_s) + 2)[:, None]
    rest = round(REST_S / law.sample_period_s)
    begin, start_um = len(scan.begin_voltage_v), law.operating_displacement_um
    before = np.arange(-begin, 0) % len(scan.position_um)
    once_v = np.concatenate([
        rest_voltage_v + ramp * way_v, np.tile(scan.begin_voltage_v[0], (rest, 1)),
        scan.begin_voltage_v])
    once_um = np.concatenate([
        np.tile(start_um, (len(ramp) + rest, 1)),
        start_um + smooth_rise(begin) * (scan.position_um[before] - start_um)])
    ticks = math.ceil((len(once_v) + periods * len(scan.voltage_v)) / law.samples_per_tick)
    return FollowedScan(once_v, scan.voltage_v, law.following(
        once_um, scan.position_um, len(once_v), max_feedback_v), ticks * law.samples_per_tick,
        ticks)
