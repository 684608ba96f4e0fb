# SPDX-License-Identifier: BSD-3-Clause
"""Errors of alternative models on held-out stretches, and the cost of their fitted parameters.

A fitted parameter costs as much as the recordings narrow it (MacKay, Bayesian interpolation, Neural
Computation 4, 1992): a parameter that they do not determine explains nothing either.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.fitting.evidence import correlated_scale
from piezo_identification.fitting.joint_fit import JointFit
from piezo_identification.fitting.regression import Fit, Regression
from piezo_models.effects import Effect, Extent, fitted_values, units_of_fitted

WIDEST = 2.3
"""Widest prior of a fitted parameter, relative to its value or as a logarithm: a decade."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors of an alternative on one recording."""

    residual_um: FloatArray
    """Residual on held-out rows, (n,)."""
    stretch: NDArray[np.intp]
    """Number of the stretch that each row belongs to, (n,)."""

    @cached_property
    def mean_square_um2(self) -> float:
        """Return the mean square residual."""
        return float(np.mean(self.residual_um**2))

    @cached_property
    def independent(self) -> float:
        """Return the number of independent errors."""
        return float(self.residual_um.size * np.mean(self.residual_um**2)
                     / correlated_scale(self.residual_um) ** 2)


@dataclass(frozen=True, eq=False)
class Remainder:
    """Remaining error of one recording."""

    name: str
    """Name of the recording."""
    held_out: HeldOut
    """Residual of samples that were not fitted."""
    period_s: float
    """Sample period."""
    travel_um: float
    motion_um: float
    """Peak-to-peak and RMS values of the measured displacement."""


def held_out_rows(regression: Regression, fit: Fit) -> list[HeldOut]:
    """Return the residual of a fit on the held-out rows of each recording."""
    residual_um, stretch = fit.residual * regression.tolerance_um, regression.dataset.stretch
    return [HeldOut(residual_um[rows], stretch[rows]) for rows in (
        mask & regression.validation for mask in regression.dataset.masks())]


def held_out_of(fit: JointFit) -> list[HeldOut]:
    """Return the residual of a joint fit on the held-out rows of each recording."""
    return held_out_rows(fit.regression, fit.regression.as_given(fit.effects))


def expected_widths(effects: Sequence[Effect], extent: Extent | None = None) -> FloatArray:
    """Return the prior standard deviations of fitted parameters of effects, (p,).

    They are a decade, or those of a uniform distribution between the bounds if that is narrower.
    The ranges of the recordings, if given, bound the parameters, too.
    """
    widths = [np.zeros(0)]
    for effect in effects:
        values, low, high = fitted_values(effect, extent)
        units = units_of_fitted(effect)
        # Coefficients of one unit are expected to be as large as the largest of them.
        largest = [max(abs(value) for value, other in zip(values, units, strict=True)
                       if other == unit) for unit in units]
        decade = WIDEST * np.where([unit is None for unit in units], 1.0, largest)
        widths.append(np.minimum((high - low) / np.sqrt(12.0), decade))
    return np.concatenate(widths)


def occam_penalty(covariance: FloatArray | None, widths: FloatArray, rows: float,
                  counted: float) -> float:
    """Return the cost of fitted parameters: the logarithm of how far the recordings narrow them.

    This is Laplace's approximation of the evidence with a Gaussian prior of the given widths
    (MacKay, Neural Computation 4, 1992): half of the sum of ln(1 + w^2 / s^2) over the principal
    directions. The cost per parameter is limited to that of a prior as informative as one error
    (Schwarz 1978), because the choice of parameters and bounds says nothing about how likely an
    effect is.

    The covariance of the parameters from the recordings is (p, p), and their prior standard
    deviations are (p,). If the covariance is None, each parameter has the largest cost. Otherwise,
    it is increased by the ratio of the number of rows of the recordings to the number of errors
    that the evidence counts. A parameter that the recordings do not determine contributes nothing.
    """
    most = 0.5 * float(np.log(max(counted, 2.0)))
    if covariance is None or covariance.shape != (widths.size, widths.size):
        return widths.size * most
    shown = (np.diag(covariance) > 0.0) & (widths > 0.0)
    of_shown = widths[shown]
    over_prior = rows / counted * covariance[np.ix_(shown, shown)] / np.outer(of_shown, of_shown)
    variances = np.maximum(np.linalg.eigvalsh(over_prior), np.finfo(float).eps)
    return float(np.sum(np.minimum(0.5 * np.log1p(1.0 / variances), most)))
