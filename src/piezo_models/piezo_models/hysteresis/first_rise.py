# SPDX-License-Identifier: BSD-3-Clause
"""First-cycle remanence: relays that switch on once within the voltage range, and never off.

A stage that was never cycled, or was depolarised, does not return from its first rise: relays
whose upper threshold alpha lies within the voltages of use and whose lower threshold beta lies
below all of them stay on. Their output depends only on the highest voltage so far. The reference
is the stage that was cycled over the whole range, to which they add nothing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray

CYCLED = float("inf")
"""Highest voltage so far of a stage that was cycled over the whole range."""


@dataclass(frozen=True)
class FirstRise:
    """Displacement that irreversible relays add when the voltage first reaches a level.

    Raises
    ------
    ValueError
        If the lengths differ, or the numbers are not in order.
    """

    voltages_v: tuple[float, ...]
    """Increasing voltages, from the lowest voltage on."""
    remanence_um: tuple[float, ...]
    """Displacement that remains after a first rise to each voltage; starts at 0, does not decrease,
    and is interpolated linearly."""

    def __post_init__(self) -> None:
        voltages_v, remanence_um = np.array(self.voltages_v), np.array(self.remanence_um)
        if voltages_v.size != remanence_um.size or voltages_v.size < 2:
            raise ValueError("voltages_v and remanence_um differ in length or are fewer than two; "
                             "give a remanence for each voltage")
        if np.any(np.diff(voltages_v) <= 0.0) or np.any(np.diff(remanence_um) < 0.0) or (
                remanence_um[0] != 0.0):
            raise ValueError("voltages_v do not increase, or remanence_um falls or does not begin "
                             "with 0; give them in the order of the first rise")

    @property
    def whole_um(self) -> float:
        """Return the remanence in um after a rise over the whole range."""
        return self.remanence_um[-1]

    def simulate(self, voltage_v: ArrayLike, highest_v: float = CYCLED) -> FloatArray:
        """Return the displacement of the first rise minus that of a cycled stage, not positive.

        Parameters
        ----------
        voltage_v : array_like, shape (N,)
        highest_v : float
            Voltage up to which the stage has risen before; by default it was cycled.

        Returns
        -------
        ndarray, shape (N,)
            In um; 0 once the voltage has reached the last of `voltages_v`.
        """
        voltage_v = np.asarray(voltage_v, dtype=float)
        if highest_v >= self.voltages_v[-1]:
            return np.zeros(voltage_v.shape)
        highest = np.maximum.accumulate(np.maximum(voltage_v, highest_v))
        return np.interp(highest, self.voltages_v, self.remanence_um) - self.whole_um
