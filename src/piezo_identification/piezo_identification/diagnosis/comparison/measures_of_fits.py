# SPDX-License-Identifier: BSD-3-Clause
"""Measures by which fits are compared on the validation set."""

import numpy as np

from piezo_identification.fitting.regression import Fit, Regression


def mean_square(regression: Regression, fit: Fit) -> float:
    """Return the mean square of what a fit leaves on the validation set, in tolerances."""
    return float(np.mean(fit.residual[regression.validation] ** 2))


def lack_of_fit(regression: Regression, fit: Fit) -> float:
    """Return the mean square left beyond the noise on the validation set, in tolerances."""
    return max(0.0, mean_square(regression, fit) - noise(regression) ** 2)


def noise(regression: Regression) -> float:
    """Return the RMS of the sensor's noise on the validation set, in tolerances."""
    return float(np.sqrt(np.mean(regression.noise_of_rows()[regression.validation] ** 2)))


def significance(regression: Regression, before: Fit, after: Fit) -> float:
    """Return how surely the second fit is better than the first on the validation set.

    The prediction by which they differ is correlated with what the first left. The products
    are summed up within each stretch, so that errors that are alike for long count as one.

    Returns
    -------
    float
        In standard deviations.
    """
    rows = regression.validation
    change = before.residual[rows] - after.residual[rows]
    stretch = regression.dataset.stretch[rows]
    signal = np.bincount(stretch, before.residual[rows] * change)
    chance = np.bincount(stretch, after.residual[rows] * change)
    # Even a perfect fit leaves the noise.
    least = np.mean(after.residual[rows] ** 2) * np.sum(change**2)
    spread = np.sqrt(max(np.sum(chance**2), least))
    return float(np.sum(signal) / spread) if spread > 0.0 else 0.0


def visible_part(regression: Regression, before: Fit, after: Fit) -> float:
    """Return the part of what effects contribute that the regressors cannot explain.

    Parameters
    ----------
    before, after : Fit
        Without and with the effects.

    Returns
    -------
    float
        From 0 to 1.
    """
    contribution = before.difference - after.difference
    contribution = contribution - contribution[regression.estimation].mean()
    whole = float(np.linalg.norm(contribution[regression.estimation]))
    return float(np.linalg.norm(regression.remainder(contribution))) / max(whole, 1e-300)


def contribution_rms(regression: Regression, before: Fit, after: Fit) -> float:
    """Return the RMS that effects contribute to the validation set, means removed, in tolerances.

    Parameters
    ----------
    before, after : Fit
        Without and with the effects.
    """
    squares, count = 0.0, 0
    for mask in regression.dataset.masks():
        added = (before.difference - after.difference)[mask & regression.validation]
        squares, count = squares + np.sum((added - added.mean()) ** 2), count + added.size
    return float(np.sqrt(squares / count))


def distance(regression: Regression, before: Fit, after: Fit) -> float:
    """Return the RMS by which two predictions of the validation set differ, in tolerances."""
    rows = regression.validation
    return float(np.sqrt(np.mean((before.residual[rows] - after.residual[rows]) ** 2)))
