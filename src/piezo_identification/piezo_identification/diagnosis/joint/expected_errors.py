# SPDX-License-Identifier: BSD-3-Clause
"""Expected residual of recordings of a complete model: noise, and errors of the model.

Errors of a model have a long correlation: at most k_r of them are independent in recording r. They
are at least as large as those of a good model, l_r, and as the known error of this model, w_r. They
are larger by a factor f, the logarithm of which has a half-normal distribution, and over which the
evidence is averaged. For a mean square m_r with noise of variance s_r^2 the evidence is
evidence is averaged. For a mean square m_r and noise of variance s_r^2 it is

    ln p = ln E_f exp(- sum_r k_r / 2 (ln v_r + (m_r - s_r^2) / v_r))
    v_r = f^2 (l_r^2 + w_r^2) + s_r^2 (k_r / n_r + d)

with n_r the number of independent samples, and d the relative error of the variance of the noise.
For a perfect model and known noise, this is the likelihood of white noise.
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
    """Size of the errors of a model."""

    carried_spread: float = 0.6
    """RMS of the logarithm of the error of a complete model in another recording, relative to the
    worst of those that it was fitted to. Set on 40 recordings of five drawn stages:
    docs/diagnosis_method.md."""
    independent: float = 10.0
    """Number of independent errors of a model in one recording. Set on the same data: the best of
    the known effects explains a third or half of them."""
    noise_known: float = 0.1
    """Relative error of the variance of the noise. Set on the same data."""
    most_wrong: float = 1e-3
    """Largest known error of a model that is accepted, relative to the RMS motion: a larger error
    shows that the model lacks something."""


SETTINGS = ErrorSettings()

DEVIATIONS = np.linspace(0.0, 4.0, 41)
"""Values of the logarithm of the factor, relative to its width, at which the evidence is summed."""
SIZES = np.exp(2.0 * SETTINGS.carried_spread * DEVIATIONS)[:, None]
"""Squares of the factor."""
WEIGHTS = -0.5 * DEVIATIONS**2 - logsumexp(-0.5 * DEVIATIONS**2)
"""Logarithms of their probabilities."""


@dataclass(frozen=True, eq=False)
class ExpectedErrors:
    """Expected RMS residual of each recording with a complete model."""

    noise_um: FloatArray
    """Noise of the sensor, (R,)."""
    model_um: FloatArray
    """Error of the model, (R,)."""
    accuracy_um: FloatArray
    """Accuracy of a good model, (R,)."""

    def of_first(self, count: int) -> "ExpectedErrors":
        """Return the expected errors of the first recordings only."""
        return ExpectedErrors(
            self.noise_um[:count], self.model_um[:count], self.accuracy_um[:count])

    def logarithms(self, squares_um2: FloatArray, samples: FloatArray) -> FloatArray:
        """Return the log-evidence of a residual.

        Parameters
        ----------
        squares_um2 : (..., R) array
            Mean squares.
        samples : (R,) array
            Number of independent samples.

        Returns
        -------
        (...) array
        """
        count = np.minimum(samples, SETTINGS.independent)
        variance = SIZES * self.model_um**2 + self.noise_um**2 * (
            count / samples + SETTINGS.noise_known)
        beyond = np.maximum(0.0, squares_um2 - self.noise_um**2)
        against = 0.5 * (np.log(variance) @ count + beyond @ (count / variance).T)
        return np.asarray(logsumexp(WEIGHTS - against, axis=-1))

    def logarithm_of_chance(self, squares_um2: FloatArray, samples: FloatArray) -> float:
        """Return the logarithm of the probability of so large a residual.

        Parameters
        ----------
        squares_um2, samples : (R,) array
            See `logarithms`.
        """
        passing = (self.noise_um**2 + self.accuracy_um**2) * (1.0 + CRITERIA.noise**2)
        wrong = self.model_um**2 - self.accuracy_um**2
        against = 0.5 * np.maximum(0.0, np.log(
            (squares_um2 + self.accuracy_um**2) / (passing + SIZES * wrong))) @ samples
        return float(logsumexp(WEIGHTS - against))


def expected_errors(dataset: Dataset, noise_um: Sequence[float],
                    stated_um: float) -> ExpectedErrors:
    """Return the expected errors of the recordings of a data set with a complete model.

    Parameters
    ----------
    noise_um : (R,) sequence of float
    """
    motion_um = np.array([np.std(part.measured_um[part.begin :]) for part in dataset.simulated])
    return errors_of_model(np.array(noise_um), accuracies_um(dataset), motion_um, stated_um)


def errors_of_model(noise_um: FloatArray, accuracy_um: FloatArray, motion_um: FloatArray,
                    stated_um: float | FloatArray) -> ExpectedErrors:
    """Return the expected errors of recordings of some motion; see `expected_errors`.

    Parameters
    ----------
    motion_um : (R,) array
        RMS of the motion.
    stated_um : float or (R,) array
    """
    wrong_um = np.minimum(stated_um, SETTINGS.most_wrong * motion_um)
    return ExpectedErrors(noise_um, np.hypot(accuracy_um, wrong_um), accuracy_um)
