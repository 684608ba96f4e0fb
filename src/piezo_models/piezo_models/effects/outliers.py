# SPDX-License-Identifier: BSD-3-Clause
"""Samples with a wrong value of the sensor."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_models.effects.effect import MOST, Effect, Evidence, parameter
from piezo_models.effects.isolated_samples import isolated

THRESHOLD = 7.0
"""Smallest size of an outlier in standard deviations of the noise."""
FEWEST = 3


@dataclass(frozen=True)
class Outliers(Effect):
    """Single samples or short runs far off their neighbours, described by size, not by time.

    They cannot be predicted. For a model with this effect, such samples are excluded from fits and
    comparisons.
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
        """Return the signal unchanged, as wrong samples cannot be predicted."""
        return signal

    @classmethod
    def starts(cls, evidence: Evidence) -> list[Self]:
        """Start with the outliers of the recording, if there are more than expected by chance."""
        residual_um = evidence.residual_um
        wrong = isolated(residual_um, evidence.voltage_v, noise=evidence.noise_um)
        if wrong.sum() < FEWEST:
            return []
        size_um = float(np.sqrt(np.mean(residual_um[wrong] ** 2)))
        return [cls(float(wrong.mean()), size_um, THRESHOLD * evidence.noise_um)]
