# SPDX-License-Identifier: BSD-3-Clause
"""Probabilities of alternatives by what they leave on held-out stretches.

No alternative is exactly right, and errors of the model may resemble the difference of two. How far
that goes is told by how much their ratio of likelihoods depends on which stretches are held out:
the probabilities are means over a Bayesian bootstrap of the stretches (pseudo-BMA+: Yao, Vehtari,
Simpson and Gelman, Using stacking to average Bayesian predictive distributions, Bayesian Analysis
13, 2018). A fitted number costs as much as the recordings narrow it (MacKay, Bayesian
interpolation, Neural Computation 4, 1992): one that they tell nothing of explains nothing either.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import softmax

from piezo_common.arrays import FloatArray
from piezo_identification.fitting.joint_fit import JointFit, correlated_scale
from piezo_models.effects import Effect, Extent, fitted_values, units_of_fitted

DRAWS = 4000
"""So many draws of the bootstrap tell a probability near 0.95 to 0.003."""
SEED = 0
WIDEST = 2.3
"""Widest prior of a fitted number, over the number or as a logarithm: a decade."""


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
    def mean_square_um2(self) -> float:
        """Return the mean square that is left."""
        return float(np.mean(self.left_um**2))

    @property
    def independent(self) -> float:
        """Return how many of the rows err independently."""
        return float(self.left_um.size * np.mean(self.left_um**2)
                     / correlated_scale(self.left_um) ** 2)


@dataclass(frozen=True, eq=False)
class Remainder:
    """What remains of one recording.

    Attributes
    ----------
    name : str
        Of the recording.
    held_out : HeldOut
        What is left of samples that were not fitted.
    period_s : float
        Sample period.
    travel_um, motion_um : float
        Peak-to-peak and RMS of the measured displacement.
    """

    name: str
    held_out: HeldOut
    period_s: float
    travel_um: float
    motion_um: float


def held_out_of(fit: JointFit) -> list[HeldOut]:
    """Return what a fit leaves of the held-out rows of each recording."""
    regression = fit.regression
    good = regression.estimation | regression.validation
    return [HeldOut(left_um[held_out], regression.dataset.stretch[mask & good][held_out])
            for (left_um, held_out), mask in zip(
                fit.left_um(), regression.dataset.masks(), strict=True)]


def probabilities_of(left: Sequence[Sequence[HeldOut]], penalties: ArrayLike,
                     least_um: ArrayLike) -> FloatArray:
    """Return the probability of each alternative.

    Parameters
    ----------
    left : sequence of sequences of HeldOut
        Of each alternative, its recordings.
    penalties : (n,) array
        What the fitted numbers of each cost; see `occam_penalty`.
    least_um : (R,) array
        Accuracy that a good model has in each recording. Its errors are alike within a stretch: so
        what an alternative explains of them counts once for each stretch, however many rows show
        it, and an effect is not bought that does no more than take up an error of the model.

    Returns
    -------
    (n,) array
    """
    recordings = list(zip(*left, strict=True))
    independent = np.array([max(part.independent for part in parts) for parts in recordings])
    stretches = np.array([np.unique(parts[0].stretch).size for parts in recordings])
    alike = np.maximum(1.0, independent / stretches)
    return shares_of(left, penalties, np.asarray(least_um) * np.sqrt(alike), independent)


def shares_of(left: Sequence[Sequence[HeldOut]], penalties: ArrayLike, least_um: ArrayLike,
              independent: ArrayLike) -> FloatArray:
    """Return the probability of each alternative, given what its fitted numbers cost.

    Parameters
    ----------
    left, least_um
        Of `probabilities_of`.
    penalties : (n,) array
        By which the logarithm of the evidence of each is less.
    independent : (R,) array
        Held-out samples of each recording that count as independent.

    Returns
    -------
    (n,) array
    """
    random = np.random.default_rng(SEED)
    logarithms = np.zeros((DRAWS, len(left))) - np.asarray(penalties)
    for number, (accuracy_um, samples) in enumerate(
            zip(np.asarray(least_um), np.asarray(independent), strict=True)):
        of_recording = [parts[number] for parts in left]
        numbers = np.unique(np.concatenate([part.stretch for part in of_recording]))
        weights = random.dirichlet(np.ones(numbers.size), DRAWS)
        for index, part in enumerate(of_recording):
            places = np.searchsorted(numbers, part.stretch)
            squares = weights @ np.bincount(places, part.left_um**2, numbers.size)
            counts = weights @ np.bincount(places, minlength=numbers.size)
            logarithms[:, index] -= 0.5 * samples * np.log(squares / counts + accuracy_um**2)
    return np.asarray(softmax(logarithms, axis=1).mean(axis=0))


def expected_widths(effects: Sequence[Effect], extent: Extent | None = None) -> FloatArray:
    """Return the standard deviations with which fitted numbers of effects are expected, (p,).

    They are a decade, or those of a uniform distribution within the bounds where these are closer.

    Parameters
    ----------
    extent : Extent, optional
        Of the recordings, which bound the numbers.

    Returns
    -------
    (p,) array
    """
    widths = [np.zeros(0)]
    for effect in effects:
        values, low, high = fitted_values(effect, extent)
        units = units_of_fitted(effect)
        # Coefficients of one unit are as large as the largest of them may make one expect.
        largest = [max(abs(value) for value, other in zip(values, units, strict=True)
                       if other == unit) for unit in units]
        decade = WIDEST * np.where([unit is None for unit in units], 1.0, largest)
        widths.append(np.minimum((high - low) / np.sqrt(12.0), decade))
    return np.concatenate(widths)


def occam_penalty(covariance: FloatArray | None, widths: FloatArray, rows: float,
                  counted: float) -> float:
    """Return what fitted numbers cost: the logarithm of how far the recordings narrow them.

    This is Laplace's approximation of the evidence with a Gaussian prior of the widths (MacKay,
    Neural Computation 4, 1992): half of the sum of ln(1 + w^2 / s^2) in the principal directions.
    None of them costs more than with a prior that tells as much as one error (Schwarz 1978): how
    an effect is parameterised, and how wide its bounds are, says nothing of how likely it is.

    Parameters
    ----------
    covariance : (p, p) array or None
        Of the numbers by the recordings; None where it is not known, and all then cost the most.
    widths : (p,) array
        Standard deviations with which the numbers are expected.
    rows, counted : float
        Rows of the recordings, and how many errors the evidence counts: by so much less does it
        determine the numbers.

    Returns
    -------
    float
        A number of which the evidence tells nothing costs nothing.
    """
    most = 0.5 * float(np.log(max(counted, 2.0)))
    if covariance is None or covariance.shape != (widths.size, widths.size):
        return widths.size * most
    shown = (np.diag(covariance) > 0.0) & (widths > 0.0)
    of_shown = widths[shown]
    over_prior = rows / counted * covariance[np.ix_(shown, shown)] / np.outer(of_shown, of_shown)
    variances = np.maximum(np.linalg.eigvalsh(over_prior), np.finfo(float).eps)
    return float(np.sum(np.minimum(0.5 * np.log1p(1.0 / variances), most)))
