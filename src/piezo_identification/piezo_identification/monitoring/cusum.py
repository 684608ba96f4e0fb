# SPDX-License-Identifier: BSD-3-Clause
"""The cumulative-sum test of Page, with the threshold that a false-alarm rate asks for.

E. S. Page, Continuous inspection schemes, Biometrika 41, 1954; D. Siegmund, Sequential Analysis,
1985, section 10.2, for the run length between false alarms.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

OVERSHOOT = 1.166
"""Siegmund's correction of the threshold for steps of unit variance: twice 0.583."""


def run_length(threshold: float, allowance: float, shift: float = 0.0) -> float:
    """Return the mean number of values until one one-sided sum crosses the threshold.

    Parameters
    ----------
    threshold : float
        In standard deviations of a value.
    allowance : float
        Subtracted from each value.
    shift : float
        Mean of the values: 0 for the run length between false alarms.

    Returns
    -------
    float
        Siegmund's approximation for independent Gaussian values of unit variance.
    """
    drift, length = shift - allowance, threshold + OVERSHOOT
    if abs(drift) < 1e-9:
        return length**2
    return float((np.exp(-2.0 * drift * length) + 2.0 * drift * length - 1.0) / (2.0 * drift**2))


def threshold_of(mean_run: float, allowance: float) -> float:
    """Return the threshold at which a one-sided sum gives a false alarm so rarely.

    Parameters
    ----------
    mean_run : float
        Values between false alarms in the mean.

    Raises
    ------
    ValueError
        If so short a run needs no sum.
    """
    if mean_run <= run_length(0.0, allowance):
        raise ValueError(f"a false alarm after {mean_run:.3g} values leaves nothing to sum up: "
                         "ask for fewer false alarms")
    highest = 1.0
    while run_length(highest, allowance) < mean_run:
        highest *= 2.0
    return float(brentq(lambda h: run_length(h, allowance) - mean_run, 0.0, highest))


@dataclass
class Cusum:
    """Two one-sided sums, for a mean that rises or falls.

    Attributes
    ----------
    threshold, allowance : float
        In standard deviations of a value.
    rise, fall : float
        The sums.
    since_rise, since_fall : int
        Values since each sum was last zero, which estimates how long ago the change was.
    """

    threshold: float
    allowance: float
    rise: float = 0.0
    fall: float = 0.0
    since_rise: int = 0
    since_fall: int = 0

    def add(self, value: float) -> int:
        """Add a value; return for how many values the mean has been changed, or 0.

        Parameters
        ----------
        value : float
            Of mean 0 and unit variance where nothing has changed.

        Returns
        -------
        int
            Positive where the mean rose, negative where it fell, 0 without an alarm. The sums begin
            anew after an alarm.
        """
        self.rise = max(0.0, self.rise + value - self.allowance)
        self.fall = max(0.0, self.fall - value - self.allowance)
        self.since_rise = self.since_rise + 1 if self.rise > 0.0 else 0
        self.since_fall = self.since_fall + 1 if self.fall > 0.0 else 0
        changed = 0
        if self.rise > self.threshold:
            changed = self.since_rise
        elif self.fall > self.threshold:
            changed = -self.since_fall
        if changed:
            self.rise = self.fall = 0.0
            self.since_rise = self.since_fall = 0
        return changed
