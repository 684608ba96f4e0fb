# SPDX-License-Identifier: BSD-3-Clause
"""A hysteresis of plays whose two sides are curves of the voltage, fitted to loops.

This is the generalised Prandtl-Ishlinskii operator (Al Janaideh, Rakheja and Su 2011): a Preisach
hysteresis whose density is that of parallel lines, bent by the two curves. Few numbers describe it,
so that it goes on well where a voltage has not been. It is the hysteresis about which a density is
smoothed where it predicts loops better than none; see `smoothed_density`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls

from piezo_common.arrays import FloatArray
from piezo_common.cancellation import check_cancelled
from piezo_identification.estimators.hysteresis.equations import HysteresisSegment
from piezo_identification.estimators.hysteresis.everett_regression import remembered_pairs

WIDTHS = np.concatenate([[0.0], np.arange(0.0025, 0.2, 0.005), np.arange(0.205, 0.5, 0.01),
                         np.arange(0.515, 1.0, 0.03)])
"""Widths of the plays, over the widest; narrow ones matter most, as every loop passes them."""

SLOPE_KNOTS = 8
"""Voltages between which the slope of the reversible part is a straight line."""

MOST_ROWS = 8_000
"""Samples that are fitted, spread over all."""

ROWS_PER_NUMBER = 10
"""Samples for each number that is fitted, at least."""

MOST_BENT = 2.0
"""Bound of each coefficient of the logarithm of a curve's slope, over voltages from -1 to 1."""

STEP, MOST_EVALUATIONS = 1e-3, 15
"""Step of the derivatives by the curves' coefficients, and steps of the search."""

WORTHWHILE = 1e-5
"""Part of the squares that a step has to gain for another: less of `MOST_ROWS` rows is chance."""

LARGEST_GAIN = 1.01
"""Factor by which the squares may rise where the reversible part, or the bend of the curves, is
left out."""

CURVE_POINTS = 401
"""Voltages between which a curve is a straight line."""


@dataclass(frozen=True, eq=False)
class PlaySum:
    """A sum of plays and a reversible part.

    Attributes
    ----------
    rising : (2,) array
        Coefficients of the logarithm of the slope of the rising sides: of the voltage and of its
        square, where the range reaches from -1 to 1.
    falling : (3,) array
        Those of the falling sides, a constant first.
    weights : (K,) array
        Of the plays of all widths, in um where the range of the voltage is 2.
    slopes : (S,) array
        Of the reversible part at knots of the voltage.
    noise_um : float
        Of the loops, from how much what the plays leave changes from row to row.
    """

    rising: FloatArray
    falling: FloatArray
    weights: FloatArray
    slopes: FloatArray
    noise_um: float

    def unknowns(self, size: int) -> FloatArray:
        """Return the plays as unknowns of `everett_regression` on a grid.

        Parameters
        ----------
        size : int
            Number n of cells along each threshold.

        Returns
        -------
        (n (n + 1) / 2 + n,) array
        """
        levels = np.linspace(-1.0, 1.0, size + 1)
        upper, lower = np.tril_indices(size)
        reversible_um = _reversible_columns(levels) @ self.slopes
        rising, falling = _curve(np.append(0.0, self.rising), levels), _curve(self.falling, levels)
        widths = _widths(np.append(0.0, self.rising), self.falling)
        ways = rising[upper + 1] - falling[lower]
        answers_um = _answers(ways, widths) @ self.weights
        everett_um = answers_um + reversible_um[upper + 1] - reversible_um[lower]
        # A smooth density has half as much in a triangle on the diagonal as in the square beside
        # it. More is that of plays so narrow that nearly all of it passes on every way through.
        diagonal = np.flatnonzero(upper == lower)
        inner_um = answers_um[diagonal]
        beside_um = answers_um[diagonal[1:] - 1] - inner_um[1:] - inner_um[:-1]
        narrow_um = np.maximum(0.0, inner_um - 0.5 * np.append(beside_um[:1], beside_um))
        return np.concatenate([everett_um, np.diff(reversible_um) + narrow_um])


def fit_plays(segments: Sequence[HysteresisSegment], levels_v: FloatArray,
              near: PlaySum | None = None) -> PlaySum | None:
    """Fit a sum of plays to loops.

    For any two curves the weights of least error are those of a linear regression without negative
    ones, so that only the curves are sought (Golub and Pereyra 1973).

    Parameters
    ----------
    segments : sequence of HysteresisSegment
        Each has offsets of its own.
    levels_v : (n + 1,) array
        Uniform and increasing; their ends are those of the range.
    near : PlaySum, optional
        Of nearly the same loops: the search begins with its curves.

    Returns
    -------
    PlaySum or None
        None where there are too few samples for so many numbers.
    """
    regression = _PlayRegression(segments, levels_v)
    if regression.count < ROWS_PER_NUMBER * (WIDTHS.size + SLOPE_KNOTS):
        return None
    straight = np.zeros(5)
    bent = least_squares(
        regression.left_um, straight if near is None else np.append(near.rising, near.falling),
        bounds=(-MOST_BENT, MOST_BENT), diff_step=STEP, x_scale=0.1, ftol=WORTHWHILE,
        max_nfev=MOST_EVALUATIONS)
    curves = bent.x
    if np.sum(regression.left_um(straight) ** 2) < LARGEST_GAIN * 2.0 * bent.cost:
        # A few loops may be those of many curves.
        curves = straight
    weights, left_um = regression.weights(curves)
    return PlaySum(curves[:2], curves[2:], weights[SLOPE_KNOTS:], weights[:SLOPE_KNOTS],
                   float(np.std(np.diff(left_um)) / np.sqrt(2.0)))


class _PlayRegression:
    """What the hysteresis gives, as a regression on plays beside offsets and transients."""

    def __init__(self, segments: Sequence[HysteresisSegment], levels_v: FloatArray) -> None:
        stride = max(1, sum(segment.samples.size for segment in segments) // MOST_ROWS)
        self._rows, self._ways, outputs, reversible, beside = [], [], [], [], []
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
            beside.append(np.column_stack([
                history[known, None] == np.arange(history.max(initial=0) + 1),
                segment.transients[samples][known]]))
            first += int(known.sum())
        self.count = first
        self._pairs = np.concatenate(self._ways)
        self._row_of_pair = np.concatenate(self._rows)
        fixed = np.zeros((first, sum(each.shape[1] for each in beside)))
        row = column = 0
        for each in beside:
            fixed[row : row + len(each), column : column + each.shape[1]] = each
            row, column = row + len(each), column + each.shape[1]
        scale = np.maximum(np.linalg.norm(fixed, axis=0), np.finfo(float).tiny)
        self._beside = np.linalg.svd(fixed / scale, full_matrices=False)[0]
        self._output_um = self._without(np.concatenate(outputs))
        self._reversible = np.concatenate(reversible)

    def _without(self, columns: FloatArray) -> FloatArray:
        """Project out the offsets and transients."""
        return columns - self._beside @ (self._beside.T @ columns)

    def weights(self, curves: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the slopes and weights of least error for two curves, and what they leave (um)."""
        rising, falling = np.append(0.0, curves[:2]), curves[2:]
        ways = _curve(rising, self._pairs[:, 0]) - _curve(falling, self._pairs[:, 1])
        plays = _play_columns(self._row_of_pair, self._pairs[:, 2], ways,
                              _widths(rising, falling), self.count)
        columns = self._without(np.hstack([self._reversible, plays]))
        triangle = np.asarray(
            np.linalg.qr(np.column_stack([columns, self._output_um]), mode="r"))
        weights, left = nnls(triangle[:, :-1], triangle[:, -1], maxiter=30 * columns.shape[1])
        # Without a reversible part and a play of no width, or with the latter.
        for first in (SLOPE_KNOTS + 1, SLOPE_KNOTS):
            fewer, without = nnls(
                triangle[:, first:-1], triangle[:, -1], maxiter=30 * columns.shape[1])
            if without**2 < LARGEST_GAIN * left**2:
                weights = np.concatenate([np.zeros(first), fewer])
                break
        return weights, self._output_um - columns @ weights

    def left_um(self, curves: FloatArray) -> FloatArray:
        """Return what the plays of least error leave for two curves, in um."""
        check_cancelled()
        return self.weights(curves)[1]


def _curve(coefficients: FloatArray, voltage: FloatArray) -> FloatArray:
    """Return a curve that is zero in the middle and rises by the exponential of a polynomial."""
    points = np.linspace(-1.0, 1.0, CURVE_POINTS)
    risen = _integral(np.exp(polyval(points, coefficients)), points)
    return np.asarray(np.interp(voltage, points, risen - np.interp(0.0, points, risen)))


def _reversible_columns(voltage: FloatArray) -> FloatArray:
    """Return the integrals of hats over the voltage, one for each knot."""
    points = np.linspace(-1.0, 1.0, CURVE_POINTS)
    knots = np.linspace(-1.0, 1.0, SLOPE_KNOTS)
    return np.column_stack([
        np.interp(voltage, points, _integral(np.interp(points, knots, hat), points))
        for hat in np.eye(SLOPE_KNOTS)])


def _integral(values: FloatArray, points: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(points))])


def _widths(rising: FloatArray, falling: FloatArray) -> FloatArray:
    """Return the widths of the plays, from the least that no voltage passes on its way nowhere."""
    points = np.linspace(-1.0, 1.0, CURVE_POINTS)
    up, down = _curve(rising, points), _curve(falling, points)
    least = max(0.0, float(np.max(up - down)))
    return least + (up[-1] - down[0] - least) * WIDTHS


def _answers(ways: FloatArray, widths: FloatArray) -> FloatArray:
    """Return what each play adds on ways from a reversal, over its weight."""
    rows = np.arange(ways.size)
    return _play_columns(rows, np.ones(ways.size), ways, widths, ways.size)


@njit(cache=True)
def _play_columns(rows: NDArray[np.intp], signs: FloatArray, ways: FloatArray, widths: FloatArray,
                  count: int) -> FloatArray:
    """Return what each play adds to each row, over its weight."""
    columns = np.zeros((count, widths.size))
    for pair in range(rows.size):
        for play in range(widths.size):
            if ways[pair] <= widths[play]:
                break
            columns[rows[pair], play] += signs[pair] * (ways[pair] - widths[play])
    return columns
