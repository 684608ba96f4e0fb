# SPDX-License-Identifier: BSD-3-Clause
"""What is left of recordings where a model lacks nothing: noise, and errors of the model.

Errors of a model are alike for long: no more than k_r of them are independent in recording r. They
are at least as large as a good model's, l_r, and as what this model is known to be wrong by, w_r.
They are larger by a factor f, whose logarithm is half of a normal distribution, and over which the
evidence is averaged. Of a mean square m_r beside noise of variance s_r^2 it is

    ln p = ln E_f exp(- sum_r k_r / 2 (ln v_r + (m_r - s_r^2) / v_r))
    v_r = f^2 (l_r^2 + w_r^2) + s_r^2 (k_r / n_r + d)

with n_r the samples that err independently, and d the relative error of the noise's own variance.
Where the model is perfect and the noise is known, this is the likelihood of white noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from piezo_common.arrays import FloatArray
from piezo_identification.diagnosis.comparison.criteria import CRITERIA
from piezo_identification.fitting.dataset import Dataset
from piezo_identification.fitting.regression import accuracies_um


@dataclass(frozen=True)
class ErrorSettings:
    """How large the errors of a model are.

    Attributes
    ----------
    carried_spread : float
        Root mean square of the logarithm of how many times as much a model is wrong by in another
        recording as in the worst of those that it was fitted to, where nothing is lacking. Set on
        40 recordings of five drawn stages: docs/diagnosis.md.
    independent : float
        Errors of a model that are independent in one recording. Set on the same: the best of the
        known effects explains a third or half of them.
    noise_known : float
        Relative error of the variance of the noise. Set on the same.
    most_wrong : float
        Part of the RMS motion that a model may be known to be wrong by at most: where it is wrong
        by more, it lacks something, and that it is known is no explanation.
    """

    carried_spread: float = 0.6
    independent: float = 10.0
    noise_known: float = 0.1
    most_wrong: float = 1e-3


SETTINGS = ErrorSettings()

DEVIATIONS = np.linspace(0.0, 4.0, 41)
"""Values of the logarithm of the factor, over its width, at which the evidence is summed."""
SIZES = np.exp(2.0 * SETTINGS.carried_spread * DEVIATIONS)[:, None]
"""Squares of the factor."""
WEIGHTS = -0.5 * DEVIATIONS**2 - logsumexp(-0.5 * DEVIATIONS**2)
"""Logarithms of their probabilities."""


@dataclass(frozen=True, eq=False)
class ExpectedErrors:
    """What is left of each recording where a model lacks nothing, RMS.

    Attributes
    ----------
    noise_um : (R,) array
        Of the sensor.
    model_um : (R,) array
        Of the model.
    accuracy_um : (R,) array
        Of a good model.
    """

    noise_um: FloatArray
    model_um: FloatArray
    accuracy_um: FloatArray

    def of_first(self, count: int) -> "ExpectedErrors":
        """Return the same of the first recordings alone."""
        return ExpectedErrors(
            self.noise_um[:count], self.model_um[:count], self.accuracy_um[:count])

    def logarithms(self, left_um2: FloatArray, samples: FloatArray) -> FloatArray:
        """Return the logarithm of the evidence of what is left.

        Parameters
        ----------
        left_um2 : (..., R) array
            Mean squares.
        samples : (R,) array
            That err independently.

        Returns
        -------
        (...) array
        """
        count = np.minimum(samples, SETTINGS.independent)
        variance = SIZES * self.model_um**2 + self.noise_um**2 * (
            count / samples + SETTINGS.noise_known)
        beyond = np.maximum(0.0, left_um2 - self.noise_um**2)
        against = 0.5 * (np.log(variance) @ count + beyond @ (count / variance).T)
        return np.asarray(logsumexp(WEIGHTS - against, axis=-1))

    def logarithm_of_chance(self, left_um2: FloatArray, samples: FloatArray) -> float:
        """Return the logarithm of the probability that as much is left.

        Parameters
        ----------
        left_um2, samples : (R,) array
            See `logarithms`.
        """
        passing = (self.noise_um**2 + self.accuracy_um**2) * (1.0 + CRITERIA.noise**2)
        wrong = self.model_um**2 - self.accuracy_um**2
        against = 0.5 * np.maximum(0.0, np.log(
            (left_um2 + self.accuracy_um**2) / (passing + SIZES * wrong))) @ samples
        return float(logsumexp(WEIGHTS - against))


def expected_errors(dataset: Dataset, noise_um: Sequence[float],
                    stated_um: float) -> ExpectedErrors:
    """Return what is left of the recordings of a data set where the model lacks nothing.

    Parameters
    ----------
    noise_um : (R,) sequence of float
    stated_um : float
        RMS of what the model is known to be wrong by.
    """
    motion_um = np.array([np.std(part.measured_um[part.begin :]) for part in dataset.simulated])
    return errors_of_model(np.array(noise_um), accuracies_um(dataset), motion_um, stated_um)


def errors_of_model(noise_um: FloatArray, accuracy_um: FloatArray, motion_um: FloatArray,
                    stated_um: float | FloatArray) -> ExpectedErrors:
    """Return what is left of recordings of some motion; see `expected_errors`.

    Parameters
    ----------
    motion_um : (R,) array
        RMS.
    stated_um : float or (R,) array
    """
    wrong_um = np.minimum(stated_um, SETTINGS.most_wrong * motion_um)
    return ExpectedErrors(noise_um, np.hypot(accuracy_um, wrong_um), accuracy_um)
