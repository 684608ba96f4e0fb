# SPDX-License-Identifier: BSD-3-Clause
"""Hysteresis of plays whose two sides are curves of the voltage, fitted to loops.

This is the generalised Prandtl-Ishlinskii operator (Al Janaideh, Rakheja and Su 2011): a Preisach
hysteresis with a density of parallel lines, bent by the two curves. It has few parameters, so that
it extrapolates well to other voltages. A density is smoothed about it if that predicts loops
better; see `smoothed_density`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from piezo_common.arrays import FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_common.long_matrix import triangle_of
from piezo_identification.estimators.hysteresis.equations import HysteresisSegment
from piezo_identification.estimators.hysteresis.everett_regression import remembered_pairs
from piezo_identification.fitting.nonnegative_regression import nonnegative_least_squares

WIDTHS = np.concatenate([[0.0], np.arange(0.0025, 0.2, 0.005), np.arange(0.205, 0.5, 0.01),
                         np.arange(0.515, 1.0, 0.03)])
"""Widths of the plays, relative to the widest; narrow ones are dense, because every loop uses
them."""

SLOPE_KNOTS = 8
"""Number of knots between which the slope of the reversible part is linear."""

MOST_ROWS = 8_000
"""Largest number of fitted samples, spread over all."""

ROWS_PER_NUMBER = 10
"""Fewest samples per fitted parameter."""

MOST_BENT = 2.0
"""Bound of each coefficient of the logarithm of a curve's slope, over voltages from -1 to 1."""

STEP, MOST_EVALUATIONS = 1e-5, 15
"""Step of the derivatives by the curves' coefficients, and largest number of steps."""

WORTHWHILE = 1e-5
"""Smallest relative decrease of the squares for a further step: less is chance with `MOST_ROWS`."""

LARGEST_GAIN = 1.01
"""Largest factor by which the squares may increase when the reversible part, or the bend of the
curves, is omitted."""

CURVE_POINTS = 401
"""Number of points between which a curve is linear."""


@dataclass(frozen=True, eq=False)
class PlaySum:
    """A sum of plays and a reversible part."""

    rising: FloatArray
    """Coefficients of the logarithm of the slope of the rising sides, for the voltage and its
    square, with the voltage range scaled to -1 to 1, (2,)."""
    falling: FloatArray
    """The same for the falling sides, with a constant first, (3,)."""
    weights: FloatArray
    """Weights of the plays of all widths, in um for a voltage range of 2, (K,)."""
    slopes: FloatArray
    """Slopes of the reversible part at knots of the voltage, (S,)."""
    noise_um: float
    """Noise of the loops, estimated from the change of the residual from row to row."""

    def unknowns(self, size: int) -> FloatArray:
        """Return the plays as unknowns of `everett_regression` on a grid of n by n cells."""
        levels = np.linspace(-1.0, 1.0, size + 1)
        upper, lower = np.tril_indices(size)
        reversible_um = _reversible_columns(levels) @ self.slopes
        rising, falling = _curve(np.append(0.0, self.rising), levels), _curve(self.falling, levels)
        widths = _widths(np.append(0.0, self.rising), self.falling)
        ways = rising[upper + 1] - falling[lower]
        answers_um = _answers(ways, widths) @ self.weights
        everett_um = answers_um + reversible_um[upper + 1] - reversible_um[lower]
        # A smooth density has half as much in a triangle on the diagonal as in the adjacent square.
        # Any excess is due to plays so narrow that they act on nearly every reversal.
        diagonal = np.flatnonzero(upper == lower)
        inner_um = answers_um[diagonal]
        adjacent_um = answers_um[diagonal[1:] - 1] - inner_um[1:] - inner_um[:-1]
        narrow_um = np.maximum(0.0, inner_um - 0.5 * np.append(adjacent_um[:1], adjacent_um))
        return np.concatenate([everett_um, np.diff(reversible_um) + narrow_um])


def fit_plays(segments: Sequence[HysteresisSegment], levels_v: FloatArray) -> PlaySum | None:
    """Fit a sum of plays to loops; return None if there are too few samples.

    For any two curves, the best weights follow from a non-negative linear regression, so that only
    the curves are sought (Golub and Pereyra 1973). Each segment has its own offsets. The levels, (n
    + 1,), are uniform and increasing; their ends define the range.
    """
    regression = _PlayRegression(segments, levels_v)
    if regression.count < ROWS_PER_NUMBER * (WIDTHS.size + SLOPE_KNOTS):
        return None
    straight = np.zeros(5)
    bent = least_squares(
        regression.residual_um, straight, regression.derivatives_um,
        bounds=(-MOST_BENT, MOST_BENT), x_scale=0.1, ftol=WORTHWHILE, max_nfev=MOST_EVALUATIONS)
    curves = bent.x
    if np.sum(regression.residual_um(straight) ** 2) < LARGEST_GAIN * 2.0 * bent.cost:
        # A few loops may be compatible with many curves.
        curves = straight
    weights, residual_um = regression.weights(curves)
    return PlaySum(curves[:2], curves[2:], weights[SLOPE_KNOTS:], weights[:SLOPE_KNOTS],
                   float(np.std(np.diff(residual_um)) / np.sqrt(2.0)))


class _PlayRegression:
    """Regression of the hysteresis output on plays, offsets and transients."""

    def __init__(self, segments: Sequence[HysteresisSegment], levels_v: FloatArray) -> None:
        stride = max(1, sum(segment.samples.size for segment in segments) // MOST_ROWS)
        self._rows, self._ways, outputs, reversible, nuisance = [], [], [], [], []
        scales = []
        first = 0
        for segment in segments:
            samples = segment.samples[::stride]
            pairs, history = remembered_pairs(segment.voltage_v, levels_v, samples)
            known = history >= 0
            row_of = np.cumsum(known) - 1 + first
            self._rows.append(row_of[pairs[:, 0].astype(np.intp)])
            self._ways.append(pairs[:, 1:])
            outputs.append(segment.output_um[samples][known])
            reversible.append(_reversible_columns(2.0 * np.clip(
                (segment.voltage_v[samples][known] - levels_v[0]) / (levels_v[-1] - levels_v[0]),
                0.0, 1.0) - 1.0))
            nuisance.append(np.column_stack([
                history[known, None] == np.arange(history.max(initial=0) + 1),
                segment.transients[samples][known]]))
            scales.append(np.full(int(known.sum()), np.sqrt(segment.weight)))
            first += scales[-1].size
        self.count, self._scale = first, np.concatenate(scales)
        self._pairs = np.concatenate(self._ways)
        self._row_of_pair = np.concatenate(self._rows)
        fixed = self._scale[:, None] * block_diag(*nuisance)
        scale = np.maximum(np.linalg.norm(fixed, axis=0), np.finfo(float).tiny)
        self._nuisance = np.linalg.svd(fixed / scale, full_matrices=False)[0]
        self._output_um = self._without(np.concatenate(outputs))
        self._reversible = np.concatenate(reversible)

    def _without(self, columns: FloatArray) -> FloatArray:
        """Weigh the rows, and project out the offsets and transients."""
        weighed = (columns.T * self._scale).T
        return np.asarray(weighed - self._nuisance @ (self._nuisance.T @ weighed))

    def weights(self, curves: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return slopes and weights for two curves, and the residual (um).

        The reversible part and the play of zero width, or only the reversible part, are omitted if
        the others explain nearly as much.
        """
        columns, triangle = self._regression(curves)
        weights, residual = nonnegative_least_squares(triangle[:, :-1], triangle[:, -1])
        for first in (SLOPE_KNOTS + 1, SLOPE_KNOTS):
            fewer, without = nonnegative_least_squares(triangle[:, first:-1], triangle[:, -1])
            if without**2 < LARGEST_GAIN * residual**2:
                weights = np.concatenate([np.zeros(first), fewer])
                break
        return weights, self._output_um - columns @ weights

    def residual_um(self, curves: FloatArray) -> FloatArray:
        """Return the residual of the best slopes and weights for two curves, in um."""
        check_cancelled()
        columns, triangle = self._regression(curves)
        self._weights, _ = nonnegative_least_squares(triangle[:, :-1], triangle[:, -1])
        self._used = columns[:, self._weights > 0.0]
        return self._output_um - columns @ self._weights

    def derivatives_um(self, curves: FloatArray) -> FloatArray:
        """Return the derivatives of the last residual by the curves, (N, 5).

        Weights that are not zero follow the curves: what they can explain of the change is
        projected out (Kaufman 1975).
        """
        weights = self._weights[SLOPE_KNOTS:]
        unmoved_um = self._plays(curves) @ weights
        changes = self._without(np.column_stack([
            (self._plays(curves + STEP * direction) @ weights - unmoved_um) / STEP
            for direction in np.eye(curves.size)]))
        used = np.linalg.qr(self._used)[0]
        return used @ (used.T @ changes) - changes

    def _regression(self, curves: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the columns of the regression, and the triangle of them with the output."""
        columns = self._without(np.hstack([self._reversible, self._plays(curves)]))
        return columns, triangle_of(np.column_stack([columns, self._output_um]))

    def _plays(self, curves: FloatArray) -> FloatArray:
        """Return the output of each play between two curves, for unit weight, (N, K)."""
        rising, falling = np.append(0.0, curves[:2]), curves[2:]
        ways = _curve(rising, self._pairs[:, 0]) - _curve(falling, self._pairs[:, 1])
        return _play_columns(self._row_of_pair, self._pairs[:, 2], ways,
                             _widths(rising, falling), self.count)


def _curve(coefficients: FloatArray, voltage: FloatArray) -> FloatArray:
    """Return a curve, zero in the middle, whose slope is the exponential of a polynomial."""
    points = np.linspace(-1.0, 1.0, CURVE_POINTS)
    risen = _integral(np.exp(polyval(points, coefficients)), points)
    return np.asarray(np.interp(voltage, points, risen - np.interp(0.0, points, risen)))


def _reversible_columns(voltage: FloatArray) -> FloatArray:
    """Return the integrals of hat functions of the voltage, one for each knot."""
    points = np.linspace(-1.0, 1.0, CURVE_POINTS)
    knots = np.linspace(-1.0, 1.0, SLOPE_KNOTS)
    return np.column_stack([
        np.interp(voltage, points, _integral(np.interp(points, knots, hat), points))
        for hat in np.eye(SLOPE_KNOTS)])


def _integral(values: FloatArray, points: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(points))])


def _widths(rising: FloatArray, falling: FloatArray) -> FloatArray:
    """Return the widths of the plays, starting from the smallest one that is possible."""
    points = np.linspace(-1.0, 1.0, CURVE_POINTS)
    up, down = _curve(rising, points), _curve(falling, points)
    least = max(0.0, float(np.max(up - down)))
    return least + (up[-1] - down[0] - least) * WIDTHS


def _answers(ways: FloatArray, widths: FloatArray) -> FloatArray:
    """Return the output of each play after a way from a reversal, for unit weight."""
    rows = np.arange(ways.size)
    return _play_columns(rows, np.ones(ways.size), ways, widths, ways.size)


@njit(cache=True)
def _play_columns(rows: NDArray[np.intp], signs: FloatArray, ways: FloatArray, widths: FloatArray,
                  count: int) -> FloatArray:
    """Return the output of each play in each row, for unit weight."""
    columns = np.zeros((count, widths.size))
    for pair in range(rows.size):
        for play in range(widths.size):
            if ways[pair] <= widths[play]:
                break
            columns[rows[pair], play] += signs[pair] * (ways[pair] - widths[play])
    return columns
