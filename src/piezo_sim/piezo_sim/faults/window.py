# SPDX-License-Identifier: BSD-3-Clause
"""The time for which a fault lasts."""

import numpy as np

from piezo_sim.plant.plant_effect import Effect, Surroundings, require


class FaultWindow:
    """A fault from ``begin_s`` to ``end_s`` of stage time; a runner's base.

    Parameters
    ----------
    effect : piezo_sim.plant.plant_effect.Effect
        Has the two times.
    surroundings : Surroundings
    """

    def __init__(self, effect: Effect, surroundings: Surroundings):
        self.effect = effect
        self._begin, self._end = (
            round(time_s / surroundings.sample_period_s)
            for time_s in (effect.begin_s, effect.end_s))
        self._at = 0

    def rest(self, level: float) -> float:
        """Nothing is broken before the stage starts."""
        return level

    def apply(self, samples: np.ndarray) -> None:
        """Spoil the samples of the window."""
        first, last = (min(max(edge - self._at, 0), samples.size)
                       for edge in (self._begin, self._end))
        if first < last:
            self.spoil(samples, first, last)
        self._at += samples.size


def require_window(effect: Effect) -> None:
    """Refuse a window that is empty or begins before the stage starts."""
    require(0.0 <= effect.begin_s < effect.end_s, effect,
            "begin_s must be at least 0 and below end_s.")
