# SPDX-License-Identifier: BSD-3-Clause
"""Outliers of all recordings that are diagnosed: an effect of the sensor, and samples left out."""

from dataclasses import dataclass

import numpy as np

from piezo_identification.conditioning.outlier_samples import outlier_text
from piezo_identification.diagnosis.selection import NOTICEABLE
from piezo_models.effects.outliers import FEWEST, THRESHOLD, Outliers


@dataclass(frozen=True)
class FoundOutliers:
    """Those of all recordings.

    Parameters
    ----------
    count : int
    share : float
        Of the samples.
    size_um : float
        RMS by which they are off.
    """

    count: int
    share: float
    size_um: float

    def effect(self, contest):
        """As an effect of the extended model."""
        threshold_um = THRESHOLD * float(np.median(contest.noise_um))
        return Outliers(self.share, self.size_um, threshold_um)

    def entry(self, contest, trial):
        """As an entry of the verdict; beside the effects of a trial."""
        left = float(np.sqrt(np.mean(
            (trial.residual * contest.tolerance_um)[contest.judge] ** 2)))
        with_them = np.hypot(left, np.sqrt(self.share) * self.size_um)
        return {
            "name": Outliers.name,
            "parameters": {"share": self.share, "size_um": self.size_um},
            "error_reduction_percent": float(100.0 * (1.0 - left / with_them)),
        }


def found_outliers(contest):
    """The outliers, if there are more than chance makes and they are worth a name.

    Parameters
    ----------
    contest : Contest

    Returns
    -------
    FoundOutliers or None
    """
    off_um, samples = [], 0
    for index, part in enumerate(contest.prepared):
        settled = slice(part.begin, None)
        wrong = contest.wrong[index][settled]
        # What stands out of the residual alone has not been put among its neighbours.
        beside_um = np.where(part.outlier, part.off_um, contest.residual_um(index))[settled]
        off_um.append(beside_um[wrong])
        samples += wrong.size
    off_um = np.concatenate(off_um)
    if off_um.size < FEWEST:
        return None
    size_um = float(np.sqrt(np.mean(off_um**2)))
    share = off_um.size / samples
    if np.sqrt(share) * size_um < NOTICEABLE * np.median(contest.tolerance_um):
        return None
    return FoundOutliers(int(off_um.size), float(share), size_um)


def left_out(contest):
    """What people are told of samples that were left out, a sentence for each recording.

    Parameters
    ----------
    contest : Contest

    Returns
    -------
    list of str
    """
    texts = [outlier_text(part.path, wrong, part.time_s)
             for part, wrong in zip(contest.prepared, contest.wrong, strict=True)]
    return [text for text in texts if text]
