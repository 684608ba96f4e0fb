# SPDX-License-Identifier: BSD-3-Clause
"""Measures by which fits are compared on the validation set."""

import numpy as np

from piezo_identification.fitting.regression import Fit, Regression


def mean_square(regression: Regression, fit: Fit) -> float:
    """Return the mean square residual of a fit on the validation set, in tolerances."""
    return float(np.mean(fit.residual[regression.validation] ** 2))


def lack_of_fit(regression: Regression, fit: Fit) -> float:
    """Return the mean square residual beyond the noise on the validation set, in tolerances."""
    return max(0.0, mean_square(regression, fit) - noise(regression) ** 2)


def noise(regression: Regression) -> float:
    """Return the RMS of the sensor noise on the validation set, in tolerances."""
    return float(np.sqrt(np.mean(regression.noise_of_rows()[regression.validation] ** 2)))


def significance(regression: Regression, before: Fit, after: Fit) -> float:
    """Return by how many standard deviations the second fit is better on the validation set.

    The difference of the predictions is correlated with the residual of the first fit. The products
    are summed within each stretch, so that errors with long correlation count as one.
    """
    rows = regression.validation
    change = before.residual[rows] - after.residual[rows]
    stretch = regression.dataset.stretch[rows]
    signal = np.bincount(stretch, before.residual[rows] * change)
    chance = np.bincount(stretch, after.residual[rows] * change)
    # The noise remains even with a perfect fit.
    least = np.mean(after.residual[rows] ** 2) * np.sum(change**2)
    spread = np.sqrt(max(np.sum(chance**2), least))
    return float(np.sum(signal) / spread) if spread > 0.0 else 0.0


def visible_part(regression: Regression, before: Fit, after: Fit) -> float:
    """Return the part (0 to 1) of what effects contribute that the regressors cannot explain."""
    contribution = before.difference - after.difference
    contribution = contribution - contribution[regression.estimation].mean()
    whole = float(np.linalg.norm(contribution[regression.estimation]))
    return float(np.linalg.norm(regression.remainder(contribution))) / max(whole, 1e-300)


def contribution_rms(regression: Regression, before: Fit, after: Fit) -> float:
    """Return the RMS contribution of effects to validation rows, without means, in tolerances."""
    squares, count = 0.0, 0
    for mask in regression.dataset.masks():
        added = (before.difference - after.difference)[mask & regression.validation]
        squares, count = squares + np.sum((added - added.mean()) ** 2), count + added.size
    return float(np.sqrt(squares / count))


def distance(regression: Regression, before: Fit, after: Fit) -> float:
    """Return the RMS difference of two predictions of the validation set, in tolerances."""
    rows = regression.validation
    return float(np.sqrt(np.mean((before.residual[rows] - after.residual[rows]) ** 2)))
