# SPDX-License-Identifier: BSD-3-Clause
"""Samples that the sensor got wrong."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import MOST, Effect, Evidence, parameter
from piezo_models.effects.isolated_samples import isolated

THRESHOLD = 7.0
"""An outlier stands out by so many standard deviations of the noise."""
FEWEST = 3


@dataclass(frozen=True)
class Outliers(Effect):
    """Single samples or short runs far off their neighbours: known by their size, not their time.

    Nothing can foretell them: a model with this effect leaves such samples out where it is fitted
    or compared with others.
    """

    name: ClassVar[str] = "outliers"
    place: ClassVar[str] = "sensor"
    of_the_stage: ClassVar[bool] = False
    follows_voltage: ClassVar[bool] = False
    remembers: ClassVar[bool] = False
    experiment: ClassVar[str] = "rest, at the full sample clock"

    share: float = parameter("1", "fixed", 0.0, 1.0)
    size_um: float = parameter("um", "fixed", 0.0, MOST)
    threshold_um: float = parameter("um", "fixed", 0.0, MOST)

    def apply(self, signal: FloatArray, sample_period_s: float,
              rest: float | None = None) -> FloatArray:
        """Return the signal itself: no sample is known to be wrong before it is seen."""
        return signal

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Begin with the outliers of the recording, if there are more than chance makes."""
        residual_um = evidence.residual_um
        wrong = isolated(residual_um, evidence.voltage_v, noise=evidence.noise_um)
        if wrong.sum() < FEWEST:
            return []
        size_um = float(np.sqrt(np.mean(residual_um[wrong] ** 2)))
        return [cls(float(wrong.mean()), size_um, THRESHOLD * evidence.noise_um)]
