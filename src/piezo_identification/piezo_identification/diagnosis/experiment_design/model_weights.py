# SPDX-License-Identifier: BSD-3-Clause
"""Probabilities of alternatives by what they leave on held-out stretches.

No alternative is exactly right, and errors of the model may resemble the difference of two. How far
that goes is told by how much their ratio of likelihoods depends on which stretches are held out:
the probabilities are means over a Bayesian bootstrap of the stretches (pseudo-BMA+: Yao, Vehtari,
Simpson and Gelman, Using stacking to average Bayesian predictive distributions, Bayesian Analysis
13, 2018). A fitted number costs half of the logarithm of the count of errors, as far as the
recordings determine it (MacKay, Bayesian interpolation, Neural Computation 4, 1992): one that they
tell nothing of explains nothing either.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import softmax

from piezo_common.arrays import FloatArray
from piezo_identification.diagnosis.joint.joint_fit import correlated_scale

DRAWS = 4000
"""So many draws of the bootstrap tell a probability near 0.95 to 0.003."""
SEED = 0


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What an alternative leaves of one recording.

    Attributes
    ----------
    left_um : (n,) array
        On held-out rows.
    stretch : (n,) array of int
        Number of the stretch of each row.
    """

    left_um: FloatArray
    stretch: NDArray[np.intp]

    @property
    def independent(self) -> float:
        """Return how many of the rows err independently."""
        return float(self.left_um.size * np.mean(self.left_um**2)
                     / correlated_scale(self.left_um) ** 2)


def probabilities_of(left: Sequence[Sequence[HeldOut]], determined: Sequence[float],
                     least_um: Sequence[float]) -> FloatArray:
    """Return the probability of each alternative.

    Parameters
    ----------
    left : sequence of sequences of HeldOut
        Of each alternative, its recordings.
    determined : (n,) array
        Fitted numbers of each that the recordings determine.
    least_um : (R,) array
        Accuracy that a good model has in each recording.

    Returns
    -------
    (n,) array
    """
    random = np.random.default_rng(SEED)
    logarithms, total = np.zeros((DRAWS, len(left))), 0.0
    for number, accuracy_um in enumerate(least_um):
        of_recording = [parts[number] for parts in left]
        samples = max(part.independent for part in of_recording)
        numbers = np.unique(np.concatenate([part.stretch for part in of_recording]))
        weights = random.dirichlet(np.ones(numbers.size), DRAWS)
        for index, part in enumerate(of_recording):
            places = np.searchsorted(numbers, part.stretch)
            squares = weights @ np.bincount(places, part.left_um**2, numbers.size)
            counts = weights @ np.bincount(places, minlength=numbers.size)
            logarithms[:, index] -= 0.5 * samples * np.log(squares / counts + accuracy_um**2)
        total += samples
    logarithms -= 0.5 * np.asarray(determined) * np.log(max(total, 2.0))
    return np.asarray(softmax(logarithms, axis=1).mean(axis=0))


def determined_numbers(information: FloatArray, widths: FloatArray) -> float:
    """Return how many of some numbers are determined by recordings, rather than by their widths.

    Parameters
    ----------
    information : (p, p) array
        Inverse of the covariance of the numbers by the recordings.
    widths : (p,) array
        In which they are expected.

    Returns
    -------
    float
        From 0 to p.
    """
    if not widths.size:
        return 0.0
    over_prior = np.linalg.eigvalsh(information * np.outer(widths, widths))
    over_prior = np.maximum(over_prior, 0.0)
    return float(np.sum(over_prior / (1.0 + over_prior)))
