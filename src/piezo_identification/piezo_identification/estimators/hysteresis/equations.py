# SPDX-License-Identifier: BSD-3-Clause
"""Normal equations of the regression on the Everett function, with the penalties of the density."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.hysteresis.everett_regression import (
    EverettRegression,
    everett_regression,
    histories,
)
from piezo_identification.estimators.hysteresis.nonnegative import nonnegative_minimum
from piezo_identification.estimators.hysteresis.penalties import (
    bounded_operator,
    curvature_operator,
    reversible_differences,
    translation_operator,
)

ROWS_AT_ONCE = 200_000
"""Number of rows of the regression that are held in memory together."""

HOLD = 1e6
"""Weight that forces a reversible part to zero, except for a millionth of its value."""


@dataclass(frozen=True, eq=False)
class HysteresisSegment:
    """Input and output of the hysteresis in a stretch without gaps."""

    voltage_v: FloatArray
    output_um: FloatArray
    """Shape (N,)."""
    samples: NDArray[np.intp]
    """Increasing indices of the samples to fit."""
    transients: FloatArray
    """Additional columns of the regression with free coefficients, (N, k)."""
    weight: float = 1.0
    """Weight of the squared error of a sample."""


@dataclass(frozen=True)
class Penalties:
    """Weights of the penalties of a density; see `smoothed_density`."""

    smoothing: float
    translation: float = 0.0

    is_reversible: bool = True
    """Whether there is a reversible part in addition to the density."""


class Equations:
    """Normal equations, accumulated over blocks of samples, (2.7).

    Parameters
    ----------
    size : int
        Number n of cells along each threshold.
    others : int
        Number of other unknowns: offsets and transients.

    Attributes
    ----------
    offset_columns : ndarray of int
        For each segment, the column (among the others) of the offset of samples with known
        past.
    about : ndarray
        Hysteresis whose output was subtracted, and about which the rest is smoothed; zero by
        default. The solution is the difference from it.
    """

    def __init__(self, size: int, others: int, about: FloatArray | None = None) -> None:
        unknowns = size * (size + 3) // 2
        self.about = np.zeros(unknowns) if about is None else about
        self.size, self.count = size, 0
        self.quadratic, self.linear = csr_array((unknowns, unknowns)), np.zeros(unknowns)
        self.border, self.corner = np.zeros((unknowns, others)), np.zeros((others, others))
        self.border_linear, self.square = np.zeros(others), 0.0
        self.offset_columns = np.zeros(1, dtype=int)

    def add(self, rows: EverettRegression, others: FloatArray, output: FloatArray,
            weight: float = 1.0) -> None:
        """Add rows of the regression, with the weight of their squared errors.

        The product of what all rows of a branch have in common is formed once.
        """
        fixed, moving = rows.branches, rows.moving
        of_branch = csr_array((np.ones(output.size), (rows.branch, np.arange(output.size))),
                              shape=(fixed.shape[0], output.size))
        mixed = fixed.T @ (of_branch @ moving)
        lengths = diags_array(of_branch.sum(axis=1))
        self.count += output.size
        self.quadratic = self.quadratic + weight * (
            fixed.T @ (lengths @ fixed) + mixed + mixed.T + moving.T @ moving)
        targets = np.column_stack([output, others])
        products = weight * (fixed.T @ (of_branch @ targets) + moving.T @ targets)
        self.linear += products[:, 0]
        self.border += products[:, 1:]
        self.corner += weight * (others.T @ others)
        self.border_linear += weight * (others.T @ output)
        self.square += weight * float(output @ output)

    def plus(self, other: "Equations", sign: float = 1.0) -> "Equations":
        """Return the equations of both sets of samples; with sign -1, those without the other's."""
        result = Equations(self.size, self.corner.shape[0], self.about)
        result.count = self.count + int(sign) * other.count
        result.offset_columns = self.offset_columns
        for name in ("quadratic", "linear", "border", "corner", "border_linear", "square"):
            setattr(result, name, getattr(self, name) + sign * getattr(other, name))
        return result

    def solve(
        self, penalties: Penalties, multiplier: FloatArray | None = None, is_rough: bool = False,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return unknowns, coefficients of the other columns, and multipliers of the bounds.

        See `nonnegative_minimum` for a rough solution.
        """
        roughness = penalties.smoothing * bending_operator(self.size)
        if penalties.translation:
            roughness = roughness + penalties.translation * _sliding(self.size)
        if not penalties.is_reversible:
            roughness = roughness + _held_at_zero(self.size)
        quadratic = self.quadratic / self.count + roughness
        border = self.border / self.count
        # The bounds apply to the sum.
        unknowns, coefficients, forces = nonnegative_minimum(
            quadratic, self.linear / self.count + quadratic @ self.about, _bounded(self.size),
            border, self.corner / self.count,
            self.border_linear / self.count + self.about @ border, multiplier, is_rough,
        )
        return unknowns - self.about, coefficients, forces

    def solve_line(self) -> tuple[FloatArray, FloatArray]:
        """Return unknowns of a line through the data, and coefficients of the other columns."""
        line = line_unknowns(self.size)
        normal = np.block([
            [np.array([[line @ (self.quadratic @ line)]]), (line @ self.border)[None]],
            [(line @ self.border)[:, None], self.corner],
        ])
        right = np.append(line @ self.linear, self.border_linear)
        slope, *coefficients = np.linalg.lstsq(normal, right, rcond=1e-13)[0]
        return slope * line, np.array(coefficients)

    def misfit(self, unknowns: FloatArray, coefficients: FloatArray) -> float:
        """Sum of squared residuals of the regression."""
        return float(self.square + (
            unknowns @ (self.quadratic @ unknowns + 2.0 * self.border @ coefficients
                        - 2.0 * self.linear)
            + coefficients @ (self.corner @ coefficients - 2.0 * self.border_linear)
        ))

    def coefficients(self, unknowns: FloatArray) -> FloatArray:
        """Return the best coefficients of the other columns for given unknowns."""
        right = self.border_linear - self.border.T @ unknowns
        return np.asarray(np.linalg.lstsq(self.corner, right, rcond=1e-13)[0])


def line_unknowns(size: int) -> FloatArray:
    """Unknowns of the regression of a line that rises by one in each cell."""
    i, j = np.tril_indices(size)
    return np.concatenate([(i + 1.0 - j), np.ones(size)])


def equations_of_folds(
    segments: Sequence[HysteresisSegment], levels_v: FloatArray,
    folds: Sequence[NDArray[np.intp]] | None = None, about: FloatArray | None = None,
) -> list[Equations]:
    """Return the equations of the samples with sufficiently known memory, by folds.

    For every segment, the fold of each of its samples is given; by default there is a single one.
    The levels are (n + 1,); for `about` see `Equations`. Raise ValueError if no sample can be used.
    """
    if folds is None:
        folds = [np.zeros(segment.samples.size, dtype=int) for segment in segments]
    listed = [histories(segment.voltage_v, levels_v, segment.samples) for segment in segments]
    widths = [
        1 + int(history.max(initial=0)) + segment.transients.shape[1]
        for segment, history in zip(segments, listed, strict=True)
    ]
    if all((history < 0).all() for history in listed):
        raise ValueError(
            "no sample lies where the voltage has been before: record at least one reversal"
        )
    count = 1 + max((int(fold.max(initial=0)) for fold in folds), default=0)
    equations = [Equations(levels_v.size - 1, sum(widths), about) for _ in range(count)]
    first = 0
    for each in equations:
        each.offset_columns = np.cumsum([0, *widths[:-1]])
    for segment, history, fold, width in zip(segments, listed, folds, widths, strict=True):
        numbers = np.arange(1, history.max(initial=0) + 1)
        known = history >= 0
        samples, fold = segment.samples[known], fold[known]
        for start in range(0, samples.size, ROWS_AT_ONCE):
            block = samples[start : start + ROWS_AT_ONCE]
            rows = everett_regression(segment.voltage_v, levels_v, block)
            others = np.zeros((block.size, sum(widths)))
            others[:, first : first + width] = np.column_stack([
                rows.history == 0, rows.history[:, None] == numbers, segment.transients[block]
            ])
            of_block = fold[start : start + ROWS_AT_ONCE]
            for number in np.unique(of_block):
                part = of_block == number
                equations[number].add(rows.select(part), others[part],
                                      segment.output_um[block][part], segment.weight)
        first += width
    return equations


@lru_cache(maxsize=8)
def _bounded(size: int) -> csr_array:
    return bounded_operator(size)


@lru_cache(maxsize=8)
def bending_operator(size: int) -> csr_array:
    """Integral of the squared second derivatives of a density over the squared range.

    The powers of the size turn differences into derivatives, and the sum into the integral.
    """
    curvature = curvature_operator(size) @ _bounded(size)[:-size]
    bend = reversible_differences(size, 2)
    return size**6 * (curvature.T @ curvature) + size**5 * (bend.T @ bend)


@lru_cache(maxsize=8)
def _sliding(size: int) -> csr_array:
    """Integral of the squared first derivatives along the diagonal."""
    translation = translation_operator(size) @ _bounded(size)[:-size]
    slope = reversible_differences(size, 1)
    return size**4 * (translation.T @ translation) + size**3 * (slope.T @ slope)


@lru_cache(maxsize=8)
def _held_at_zero(size: int) -> csr_array:
    """Penalty that forces reversible parts to zero; rows of the regression are of order one."""
    crossings = size * (size + 1) // 2
    return HOLD * diags_array(np.repeat([0.0, 1.0], [crossings, size])).tocsr()
