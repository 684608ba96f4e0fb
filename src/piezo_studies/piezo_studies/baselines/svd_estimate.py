# SPDX-License-Identifier: BSD-3-Clause
"""Truncated singular value decomposition of the normal equations, and its update by new samples."""

from dataclasses import dataclass, replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.hysteresis.density_estimate import (
    DensityEstimate,
    lower_triangle,
)
from piezo_identification.estimators.hysteresis.everett_regression import visited_cells
from piezo_studies.baselines.relay_regression import NormalEquations


@dataclass(frozen=True, eq=False)
class TruncatedSvd:
    """M = A^T A reduced to its largest singular values, (2.9), and the right side A^T Y.

    M is symmetric and positive semidefinite, so U and V are equal.
    """

    vectors: np.ndarray
    """Singular vectors U_r, (n, r)."""
    singular_values: np.ndarray
    """Kept singular values in descending order, (r,)."""
    right_side: np.ndarray
    """Right side A^T Y, (n,)."""
    all_singular_values: np.ndarray
    """Singular values before the truncation, (n,)."""

    @property
    def rank(self) -> int:
        """Return the number r of singular values kept."""
        return self.singular_values.size

    def solution(self) -> FloatArray:
        """Return the least-squares estimate of minimum norm, (2.12) and (2.25)."""
        return self.vectors @ ((self.vectors.T @ self.right_side) / self.singular_values)

    def updated(self, row: FloatArray, output: float, fixed_rank: bool = True) -> "TruncatedSvd":
        """Return the SVD after one more sample with row a_1, (n,), and output y_1, (2.13)-(2.24).

        With `fixed_rank` the rank stays, as in the thesis; otherwise, it grows if the row adds a
        direction.
        """
        along = self.vectors.T @ row
        across = row - self.vectors @ along
        # Orthogonalize twice, because of rounding.
        again = self.vectors.T @ across
        along, across = along + again, across - self.vectors @ again
        distance = np.linalg.norm(across)
        new = distance > 1e-10 * np.linalg.norm(row)
        basis = np.column_stack([self.vectors, across / distance]) if new else self.vectors
        part = np.append(along, distance) if new else along
        core = np.outer(part, part)
        core[np.arange(self.rank), np.arange(self.rank)] += self.singular_values
        values, rotation = np.linalg.eigh(core)
        kept = slice(None, -self.rank - 1, -1) if fixed_rank else slice(None, None, -1)
        return replace(
            self, vectors=basis @ rotation[:, kept], singular_values=values[kept],
            right_side=self.right_side + row * output,
        )


def truncated_svd(equations: NormalEquations, ratio: float = 0.0, least: float = 0.0,
                  rank: int | None = None) -> TruncatedSvd:
    """Keep `rank` singular values, or those above two bounds, (2.8)-(2.11).

    The bounds are `least` and a ratio of the largest value.

    ValueError is raised if none is kept.
    """
    values, vectors = np.linalg.eigh(equations.matrix)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    if rank is None:
        rank = int(np.count_nonzero(values > max(least, ratio * values[0])))
    if rank < 1 or values[rank - 1] <= 0.0:
        raise ValueError(
            f"no {max(rank, 1)} singular values are above zero: keep fewer, or add samples"
        )
    return TruncatedSvd(vectors[:, :rank], values[:rank], equations.right_side, values)


@dataclass(frozen=True, eq=False, kw_only=True)
class SvdEstimate(DensityEstimate):
    """A density by a truncated singular value decomposition."""

    singular_values: np.ndarray
    """Singular values of the normal equations in descending order."""
    rank: int
    """Number of kept singular values."""


def density_by_svd(decomposition: TruncatedSvd, voltage_v: FloatArray,
                   levels_v: FloatArray) -> SvdEstimate:
    """Return the density of a decomposition on the relay grid in the common form of estimates.

    The voltages, (N,), of the samples used give the visited cells; the part of the density that no
    sample determines has minimum norm.
    """
    size = levels_v.size - 1
    area_v2 = (levels_v[1] - levels_v[0]) ** 2 * (np.ones((size, size)) - 0.5 * np.eye(size))
    return SvdEstimate(
        "truncated SVD", levels_v, lower_triangle(decomposition.solution(), size) / area_v2, 0.0,
        visited_cells(voltage_v, levels_v), np.zeros(size),
        singular_values=decomposition.all_singular_values, rank=decomposition.rank)
