# SPDX-License-Identifier: BSD-3-Clause
"""Samples that the sensor got wrong."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.ndimage import median_filter

from piezo_models.effects.effect import Effect, parameter

NEIGHBOURS = 11
"""Samples of the running median; a burst shorter than half of them stands out."""
AROUND = 51
"""Samples in which the neighbours' own spread is taken."""
THRESHOLD = 7.0
"""In standard deviations of the noise."""
FEWEST = 3


@dataclass(frozen=True)
class Outliers(Effect):
    """Single samples or short bursts far off their neighbours: known by their size, not their time.

    Nothing can foretell them: a model with this effect leaves such samples out where it is fitted
    or judged.
    """

    name: ClassVar[str] = "outliers"
    place: ClassVar[str] = "sensor"
    follows_voltage: ClassVar[bool] = False
    remembers: ClassVar[bool] = False
    experiment: ClassVar[str] = "rest, at the full sample clock"

    share: float = parameter("1", "fixed", 0.0, 1.0)
    size_um: float = parameter("um", "fixed", 0.0, 1e9)
    threshold_um: float = parameter("um", "fixed", 0.0, 1e9)

    def apply(self, signal, sample_period_s, rest=None):
        """See `Effect.apply`: the signal, for no sample is known to be wrong before it is seen."""
        return signal

    @classmethod
    def find(cls, residual_um, noise_um):
        """Mask of the samples far off their neighbours.

        Parameters
        ----------
        residual_um : (N,) array
        noise_um : float
            Standard deviation of the noise of a sample, at least.

        Returns
        -------
        (N,) array of bool
        """
        off_um = np.abs(residual_um - median_filter(residual_um, NEIGHBOURS, mode="nearest"))
        # What the model does not explain moves the neighbours too.
        around_um = 1.4826 * median_filter(off_um, AROUND, mode="nearest")
        return off_um > THRESHOLD * np.maximum(noise_um, around_um)

    @classmethod
    def starts(cls, evidence):
        """The outliers of the recording, if there are more than chance makes."""
        wrong = cls.find(evidence.residual_um, evidence.noise_um)
        if wrong.sum() < FEWEST:
            return []
        size_um = float(np.sqrt(np.mean(evidence.residual_um[wrong] ** 2)))
        return [cls(float(wrong.mean()), size_um, THRESHOLD * evidence.noise_um)]
