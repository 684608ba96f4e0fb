# SPDX-License-Identifier: BSD-3-Clause
"""Linear regression of the residual on nuisance signals and changes of the model's parameters.

The nuisance regressors are free. The changes of the model's parameters have a prior variance, so
that they explain an error only with plausible changes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.fitting.dataset import Dataset
from piezo_identification.fitting.noise_estimate import NoiseEstimate, estimate_noise
from piezo_identification.fitting.parameter_sensitivities import perturbed
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect, fitted_values
from piezo_models.effects.outliers import Outliers


@dataclass(frozen=True)
class RegressionSettings:
    """Weights of the regression."""

    prior_share: float = 0.02
    """Cost of a parameter change by its prior width, as a fraction of the unexplained energy beyond
    the noise. Even large errors are then explained only with plausible changes."""
    least_share: float = 0.05
    """Smallest unexplained energy that is assumed, as a fraction of the noise energy."""
    model_tolerance: float = 1e-4
    """Accuracy of a good model, as a fraction of the travel: smaller errors do not justify an
    effect."""
    adequate_tolerance: float = 2e-5
    """Accuracy of an adequate model, as a fraction of the travel: rounding, the grid of the density
    and errors of other components are as large."""


SETTINGS = RegressionSettings()


def accuracies_um(dataset: Dataset) -> FloatArray:
    """Return the accuracy that a good model has in each recording."""
    return np.array([
        SETTINGS.model_tolerance * np.ptp(part.measured_um) for part in dataset.simulated])


@dataclass(frozen=True, eq=False)
class Fit:
    """Fitted effects and the residual with them."""

    effects: tuple[Effect, ...]

    residual: FloatArray
    """Part of `difference` that the regressors do not explain, (r,)."""
    difference: FloatArray
    """Measured minus simulated displacement at all rows, divided by the tolerance of its recording,
    (r,)."""
    coefficients: FloatArray
    """Coefficients of the regressors, (m,)."""
    covariance: FloatArray | None = None
    """Covariance of the fitted values of the effects, (p, p)."""

    @property
    def parameter_count(self) -> int:
        """Return the number of fitted parameters."""
        return sum(fitted_values(effect)[0].size for effect in self.effects
                   if type(effect) is not Outliers)

    def without(self, number: int) -> tuple[Effect, ...]:
        """Return all effects except one."""
        return (*self.effects[:number], *self.effects[number + 1 :])


@dataclass(frozen=True, eq=False)
class Regression:
    """A weighted regression on the estimation rows of a data set."""

    dataset: Dataset
    noise: NoiseEstimate

    tolerance_um: FloatArray
    """Combined noise and accuracy of a good model, (r,)."""
    estimation: BoolArray
    validation: BoolArray
    """Rows without outliers that are fitted, and those of the validation set, (r,)."""
    prior: FloatArray
    """Rows that contain the prior of the parameters, (p, m)."""

    @property
    def weighted(self) -> FloatArray:
        """Return the regressors divided by the tolerance, (r, m)."""
        return np.asarray(self.dataset.regressors / self.tolerance_um[:, None])

    @cached_property
    def _factors(self) -> tuple[FloatArray, FloatArray]:
        """Return the QR factors of the estimation rows and the prior together.

        They are as large as the recordings, and are computed only when needed.
        """
        q, r = np.linalg.qr(np.vstack([self.weighted[self.estimation], self.prior]))
        return q, r

    def simulated_as(self, dataset: Dataset) -> "Regression":
        """Return the regression with other simulations of the same rows, and its QR factors."""
        other = replace(self, dataset=dataset)
        vars(other)["_factors"] = self._factors
        return other

    def difference(self, effects: Sequence[Effect], quick: Sequence[Effect] = ()) -> FloatArray:
        """Return measured minus simulated displacement, divided by the tolerance, (r,)."""
        return self.dataset.difference_um(effects, quick) / self.tolerance_um

    def remainder(self, difference: FloatArray) -> FloatArray:
        """Return the residual of the estimation rows, followed by that of the prior."""
        padded, (q, _) = self._padded(difference), self._factors
        return padded - q @ (q.T @ padded)

    def fit(self, effects: Sequence[Effect], covariance: FloatArray | None = None,
            quick: Sequence[Effect] = ()) -> Fit:
        """Fit the regressors with the effects fixed.

        The covariance, (p, p), is that of the fitted values of the effects, if they were fitted.
        For `quick` see `SimulatedRecording.simulate`.
        """
        difference, (q, r) = self.difference(effects, quick), self._factors
        coefficients = np.linalg.lstsq(r, q.T @ self._padded(difference), rcond=1e-12)[0]
        explained = self.dataset.regressors @ coefficients / self.tolerance_um
        return Fit(tuple(effects), difference - explained, difference,
                   np.asarray(coefficients, dtype=float), covariance)

    def as_given(self, effects: Sequence[Effect] = ()) -> Fit:
        """Fit the nuisance regressors only, with the effects and the model fixed.

        All rows are used: otherwise initial creep that shows only in held-out rows would be
        undetermined.
        """
        dataset, difference = self.dataset, self.difference(effects)
        rows, count = self.estimation | self.validation, dataset.nuisance_count
        nuisance = dataset.regressors[:, :count] / self.tolerance_um[:, None]
        coefficients = np.zeros(dataset.regressors.shape[1])
        coefficients[:count] = np.linalg.lstsq(nuisance[rows], difference[rows], rcond=1e-12)[0]
        return Fit(tuple(effects), difference - nuisance @ coefficients[:count], difference,
                   coefficients)

    def noise_of_rows(self) -> FloatArray:
        """Return the sensor noise at all rows, in tolerances, (r,)."""
        return self.dataset.of_each(self.noise.noise_um) / self.tolerance_um

    def residual_um(self, fit: Fit) -> float:
        """Return the RMS residual of a fit on the validation set, including noise."""
        return float(np.sqrt(np.mean((fit.residual * self.tolerance_um)[self.validation] ** 2)))

    def extended_model(self, fit: Fit) -> StageModel:
        """Return the model with the effects of a fit and with its parameters fitted together."""
        dataset = self.dataset
        model = perturbed(dataset.model, fit.coefficients[dataset.nuisance_count :])
        return replace(model, effects=(*dataset.model.effects, *fit.effects))

    def _padded(self, difference: FloatArray) -> FloatArray:
        parameters = self.dataset.regressors.shape[1] - self.dataset.nuisance_count
        return np.concatenate([difference[self.estimation], np.zeros(parameters)])


def weighted_regression(dataset: Dataset, noise: NoiseEstimate,
                        effects: Sequence[Effect] = ()) -> Regression:
    """Weigh the rows, with a prior that matches the residual with some effects.

    The more the effects explain, the less the model's parameters may change.
    """
    tolerance_um = dataset.of_each(np.hypot(noise.noise_um, accuracies_um(dataset)))
    estimation = dataset.for_estimation & ~dataset.at_rows(noise.outliers)
    nuisance = (dataset.regressors[:, : dataset.nuisance_count]
                / tolerance_um[:, None])[estimation]
    residual = (dataset.difference_um(effects) / tolerance_um)[estimation]
    residual = residual - nuisance @ np.linalg.lstsq(nuisance, residual, rcond=1e-12)[0]
    noise_energy = float(
        np.sum((dataset.of_each(noise.noise_um) / tolerance_um)[estimation] ** 2))
    energy = max(residual @ residual - noise_energy, SETTINGS.least_share * noise_energy)
    return regression_with(dataset, noise, tolerance_um, np.sqrt(SETTINGS.prior_share * energy))


def regression_with(dataset: Dataset, noise: NoiseEstimate, tolerance_um: FloatArray,
                    cost: float) -> Regression:
    """Weigh the rows by their tolerances, (r,), and changes of parameters by a cost per width."""
    good = ~dataset.at_rows(noise.outliers)
    prior = cost * np.eye(dataset.regressors.shape[1])[dataset.nuisance_count :]
    return Regression(dataset, noise, tolerance_um, dataset.for_estimation & good,
                      ~dataset.for_estimation & good, prior)


def first_regression(dataset: Dataset) -> Regression:
    """Weigh the rows by the noise and outliers estimated with the model as given."""
    return weighted_regression(dataset, estimate_noise(dataset))


def reweighted(regression: Regression, effects: Sequence[Effect]) -> Regression:
    """Estimate noise and outliers again with effects, and weigh the rows by them."""
    noise = estimate_noise(regression.dataset, effects, regression.noise)
    return weighted_regression(regression.dataset, noise, effects)


def fit_without_effects(regression: Regression) -> Fit:
    """Fit the regressors alone, with a prior that matches their own residual."""
    return weighted_regression(regression.dataset, regression.noise).fit(())


def with_fixed_parameters(regression: Regression, effects: Sequence[Effect]) -> Regression:
    """Return the regression with some effects and with the model's parameters held fixed."""
    dataset = regression.dataset
    regressors = dataset.regressors.copy()
    regressors[:, dataset.nuisance_count :] = 0.0
    return weighted_regression(
        replace(dataset, regressors=regressors), regression.noise, effects)
