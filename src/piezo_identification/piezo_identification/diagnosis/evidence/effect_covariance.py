# SPDX-License-Identifier: BSD-3-Clause
"""Uncertainty of effects that were fitted with an inexact model.

The model of a hysteresis is not exact, and its errors repeat in every cycle. For example, a loop
that is too narrow at some span resembles a part of a delay or a play, which a fit then includes.
This bias is not visible in the residual or its scatter, but the remaining errors of the density
are. Random errors of the density are therefore drawn, and an estimate that is linear about the
optimum,

    change of the effects = (G' G)^-1 G' e,

gives the change of the effects due to each of them, with G the derivatives after projecting out the
regressors. The size of the errors e follows from the residual power in their shapes, compared with
what is expected by chance. An error is common to all cells of one span, because an identification
averages over loops of one span, and its cells are too wide for a density that changes near its
diagonal everywhere.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from scipy.linalg import orth, pinvh
from scipy.stats import norm

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.means import block_means
from piezo_identification.fitting.dataset import Dataset
from piezo_identification.fitting.evidence import BLOCKS
from piezo_identification.fitting.regression import Fit, Regression
from piezo_models.effects import Effect, fitted_values, with_fitted_values
from piezo_models.hysteresis.preisach import PreisachModel

DRAWS = 32
"""Number of drawn errors of the model: their spread is then known to about an eighth."""
SMALL = 0.01
"""Relative change of the density, to which the response is linear; the value is arbitrary."""
STEP = float(np.finfo(float).eps ** (1.0 / 3.0))
"""Relative step of central differences."""


def with_model_errors(regression: Regression, fit: Fit) -> Fit:
    """Return a fit whose covariance includes errors of the model."""
    if fit.covariance is None or not fit.covariance.size:
        return fit
    slopes = np.column_stack([
        regression.remainder(column)
        for column in sensitivities(regression.difference, fit.effects).T])
    scales = np.linalg.norm(slopes, axis=0)
    scales[scales == 0.0] = 1.0
    scaled = slopes / scales
    inverse = pinvh(scaled.T @ scaled)
    errors = np.column_stack([
        regression.remainder(error_um / regression.tolerance_um)
        for error_um in drawn_errors_um(regression.dataset)])
    rows = np.count_nonzero(regression.estimation)

    def without_effects(columns: FloatArray) -> FloatArray:
        """Return columns with the part along the effects removed."""
        return (columns - scaled @ (inverse @ (scaled.T @ columns)))[:rows]

    noise, size = noise_and_errors(
        without_effects(regression.remainder(fit.difference)), without_effects(errors))
    changes = inverse @ (scaled.T @ errors) / scales[:, None]
    white = noise * np.diag(inverse) / scales**2
    # The scatter of the residual does not include the prior of the parameters, and white noise
    # does not include errors shared by neighbours.
    missing = np.diag(np.maximum(0.0, white - np.diag(fit.covariance)))
    return replace(
        fit, covariance=fit.covariance + missing + size * (changes @ changes.T) / DRAWS)


def sensitivities(signal_of: Callable[..., FloatArray],
                  effects: tuple[Effect, ...]) -> FloatArray:
    """Return the change of a signal of effects, (N,), with each of their fitted values, (N, m)."""
    columns = []
    for number, effect in enumerate(effects):
        values, low, high = fitted_values(effect)
        for index, value in enumerate(values):
            step = STEP * max(abs(value), 1e-3)
            ends = np.clip([value - step, value + step], low[index], high[index])
            below, above = (signal_of(_moved(effects, number, index, end)) for end in ends)
            columns.append((above - below) / np.ptp(ends))
    return np.column_stack(columns) if columns else np.zeros((signal_of(effects).size, 0))


def _moved(effects: tuple[Effect, ...], number: int, index: int,
           value: float) -> tuple[Effect, ...]:
    """Return effects with one fitted value changed."""
    values, _, _ = fitted_values(effects[number])
    values[index] = value
    return (*effects[:number], with_fitted_values(effects[number], values), *effects[number + 1 :])


def drawn_errors_um(dataset: Dataset) -> Iterator[FloatArray]:
    """Yield the changes of the rows due to drawn errors of the density, each (r,)."""
    linear, hysteresis = dataset.model.linear(), dataset.model.hysteresis
    given_um = [part.hysteresis_output_um(hysteresis) for part in dataset.simulated]
    for erring in _erring(hysteresis):
        yield np.concatenate([
            part.respond(linear, part.hysteresis_output_um(erring) - without_um, at=rows)
            for part, rows, without_um in zip(
                dataset.simulated, dataset.rows, given_um, strict=True)])


def _erring(hysteresis: PreisachModel) -> Iterator[PreisachModel]:
    """Yield the hysteresis with random factors of the density, one for all cells of a span."""
    random = np.random.default_rng(0)
    density = hysteresis.density_um_per_v2
    rising, falling = np.indices(density.shape)
    for _ in range(DRAWS):
        factors = 1.0 + SMALL * random.standard_normal(len(density))
        yield replace(hysteresis, density_um_per_v2=density * factors[np.abs(rising - falling)])


def noise_and_errors(residual: FloatArray, errors: FloatArray) -> tuple[float, float]:
    """Return the variance of white noise, and the size of drawn errors, from a residual.

    Half of the drawn errors span the shapes of errors of the density in these rows. The residual
    has more power in these shapes than elsewhere in proportion to the size of such errors. The
    other half shows how much more power errors of unit size would have. Block means are compared,
    in which white noise is smaller. Even if the difference is within its scatter, errors may be
    present: the size is the mean of a normal distribution about the estimate, truncated at zero.

    The residual is (n,), and the drawn errors, after projecting out effects and regressors, are
    (n, d). The size is a factor of their squares.
    """
    # Averaging reduces white noise, but not errors of the model.
    means = block_means(np.column_stack([residual, errors]).T, BLOCKS[0]).T
    half, total = min(errors.shape[1], len(means)) // 2, float(np.mean(residual**2))
    shapes = orth(means[:, 1 : 1 + half])
    if not shapes.size:
        return total, 0.0  # the rows are too few, or there is no density
    within, beyond = powers(means, shapes)
    expected = np.mean((within - beyond)[1 + half :])
    if expected <= 0.0 or within[0] <= 0.0:
        return total, 0.0
    size = (within[0] - beyond[0]) / expected
    deviation = within[0] * np.sqrt(2.0 / shapes.shape[1]) / expected
    over = size / deviation
    size += deviation * np.exp(norm.logpdf(over) - norm.logcdf(over))
    return max(0.0, total - size * float(np.mean(errors**2))), float(size)


def powers(columns: FloatArray, shapes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean square of columns, (n, m), per shape, and per other direction, each (m,).

    The shapes, (n, k), are orthonormal, with k less than n. For white noise both are equal.
    """
    count, number = shapes.shape
    within = np.sum((shapes.T @ columns) ** 2, axis=0)
    beyond = np.sum(columns**2, axis=0) - within
    return within / number, beyond / (count - number)
