# SPDX-License-Identifier: BSD-3-Clause
"""Outliers of all diagnosed recordings, as an effect of the sensor and as excluded samples."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from piezo_identification.conditioning.outlier_samples import outlier_text
from piezo_identification.diagnosis.comparison.criteria import CRITERIA
from piezo_identification.fitting.noise_estimate import residual_um
from piezo_identification.fitting.regression import Fit, Regression
from piezo_models.effects import Effect
from piezo_models.effects.converter_steps import SensorSteps
from piezo_models.effects.outliers import FEWEST, THRESHOLD, Outliers

NEXT_STEP = 1.6
"""Largest error of a reading that is rounded to the neighbouring step, in steps of the sensor."""


@dataclass(frozen=True)
class FoundOutliers:
    """Number and size of the outliers of all recordings."""

    count: int

    share: float
    """Fraction of the samples."""
    size_um: float
    """RMS error of these samples."""

    def effect(self, regression: Regression) -> Outliers:
        """Return the effect that represents them in the extended model."""
        threshold_um = THRESHOLD * float(np.median(regression.noise.noise_um))
        return Outliers(self.share, self.size_um, threshold_um)

    def entry(self, regression: Regression, fit: Fit) -> dict[str, Any]:
        """Return their entry of the verdict, in addition to the effects of a fit."""
        residual_rms_um = regression.residual_um(fit)
        with_them = np.hypot(residual_rms_um, np.sqrt(self.share) * self.size_um)
        return {
            "name": Outliers.name,
            "parameters": {"share": self.share, "size_um": self.size_um},
            "error_reduction_percent": float(100.0 * (1.0 - residual_rms_um / with_them)),
        }


def found_outliers(regression: Regression,
                   effects: Sequence[Effect] = ()) -> FoundOutliers | None:
    """Return the outliers if they are more than expected by chance and large enough to be named.

    Parameters
    ----------
    effects : sequence of piezo_models.effects.effect.Effect
        Named effects. If the sensor has steps, a reading of a neighbouring step is no outlier.
    """
    least_um = max((NEXT_STEP * effect.step_um for effect in effects
                    if isinstance(effect, SensorSteps)), default=0.0)
    off_um, samples = [], 0
    for index, part in enumerate(regression.dataset.simulated):
        settled = slice(part.begin, None)
        outlier = regression.noise.outliers[index][settled]
        # Samples that stand out of the residual only have no interpolated neighbours.
        unexplained_um = residual_um(regression.dataset, index, noise=regression.noise)
        off_model_um = np.where(part.outlier, part.off_um, unexplained_um)[settled]
        off_um.append(off_model_um[outlier & (np.abs(off_model_um) >= least_um)])
        samples += outlier.size
    joined_um = np.concatenate(off_um)
    if joined_um.size < FEWEST:
        return None
    size_um = float(np.sqrt(np.mean(joined_um**2)))
    share = joined_um.size / samples
    if np.sqrt(share) * size_um < CRITERIA.noticeable * np.median(regression.tolerance_um):
        return None
    return FoundOutliers(int(joined_um.size), float(share), size_um)


def left_out(regression: Regression) -> list[str]:
    """Return a sentence on the excluded samples of each recording that has any."""
    texts = [outlier_text(part.path, outlier, part.time_s) for part, outlier in
             zip(regression.dataset.simulated, regression.noise.outliers, strict=True)]
    return [text for text in texts if text]
