# SPDX-License-Identifier: BSD-3-Clause
"""The density by smoothed non-negative least squares, on any recording and on large grids."""

from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csr_array, eye_array, hstack, vstack

from piezo_identification.estimators.hysteresis.density_estimate import (
    DensityEstimate,
    lower_triangle,
)
from piezo_identification.estimators.hysteresis.everett_regression import (
    density_operator,
    everett_regression,
    visited_cells,
)
from piezo_identification.estimators.hysteresis.nonnegative import nonnegative_minimum

SMOOTHING_WEIGHTS = tuple(10.0**power for power in range(-8, -16, -1))
"""Weights of the density's curvature, tried on samples held out from the largest down."""

CELLS_FOR_THE_WEIGHT = 50
"""Cells along a threshold on which the weight is chosen: it means the same on any grid."""

ROWS_AT_ONCE = 200_000
"""Rows of the regression that are held in memory together."""


def smoothed_density(
    voltage_v, output_um, levels_v, samples=None, transients=None, smoothing_weight=None,
    level_count=None, translation_weight=0.0,
):
    """Density that is nowhere negative and as smooth as the data allow.

    Minimises the mean square of what the regression on the Everett values leaves, and the weighted
    integral of the squares of the density's second derivatives along both thresholds (voltages in
    units of the range). The reversible part on the diagonal is smoothed alike, as a function of the
    voltage. Everything is sparse: Everett values and reversible part are the unknowns, the density
    is the mixed second difference of what the second leaves of the first.

    Parameters
    ----------
    voltage_v, output_um : ndarray, shape (N,)
        Any input, and the output of the hysteresis. For the start see `everett_regression`.
    levels_v : ndarray, shape (n + 1,)
        Edges of the cells, uniform and increasing.
    samples : ndarray of int, optional
        Increasing indices of the samples to fit; all by default.
    transients : ndarray, shape (N, k), optional
        Further columns of the regression, whose coefficients are free.
    smoothing_weight : float, optional
        By default the largest of `SMOOTHING_WEIGHTS` that predicts held-out stretches as well as
        any, within what chance does to their mean square.
    level_count : int, optional
        Number of equal steps of voltage by which a cell counts as visited; n by default.
    translation_weight : float
        Weight of the integral of the squares of the density's first derivative along the diagonal.
        A small one lets the density outside the visited cells be that of equally wide loops
        elsewhere, where the curvature alone would go on straight.

    Returns
    -------
    DensityEstimate

    Raises
    ------
    ValueError
        If no sample can be used.
    """
    voltage_v = np.asarray(voltage_v, dtype=float)
    samples = np.arange(voltage_v.size) if samples is None else samples
    transients = np.empty((voltage_v.size, 0)) if transients is None else transients
    size = levels_v.size - 1
    multiplier = None
    if smoothing_weight is None:
        coarse = min(size, CELLS_FOR_THE_WEIGHT)
        coarse_v = np.linspace(levels_v[0], levels_v[-1], coarse + 1)
        smoothing_weight, forces = _best_weight(
            voltage_v, output_um, coarse_v, samples, transients, translation_weight
        )
        # The bounds that hold are found on grids twice as fine each time, where that costs little.
        while 2 * coarse < size:
            finer = 2 * coarse
            finer_v = np.linspace(levels_v[0], levels_v[-1], finer + 1)
            equations = _Equations.of(
                voltage_v, output_um, finer_v, samples, transients, translation_weight
            )
            *_, forces = equations.solve(smoothing_weight, _on_finer_grid(forces, coarse, finer))
            coarse = finer
        multiplier = _on_finer_grid(forces, coarse, size)
    equations = _Equations.of(
        voltage_v, output_um, levels_v, samples, transients, translation_weight
    )
    unknowns, beside, _ = equations.solve(smoothing_weight, multiplier)
    bounded = np.maximum(bounded_operator(size) @ unknowns, 0.0)
    density, reversible = np.split(bounded, [-size])
    width_v = (levels_v[-1] - levels_v[0]) / size
    level_count = size if level_count is None else level_count
    seen = visited_cells(voltage_v, np.linspace(levels_v[0], levels_v[-1], level_count + 1))
    cell = np.arange(size) * level_count // size
    return DensityEstimate(
        "smoothed non-negative least squares", levels_v,
        lower_triangle(density, size) / width_v**2, float(beside[0]),
        np.tril(seen[np.ix_(cell, cell)]), smoothing_weight=smoothing_weight,
        reversible_um_per_v=reversible / width_v,
    )


def bounded_operator(size):
    """Return the operator of what must not be negative: densities and reversible parts.

    Parameters
    ----------
    size : int

    Returns
    -------
    csr_array, shape (n (n + 1) / 2 + n, n (n + 1) / 2 + n)
        Acts on the unknowns of the regression.
    """
    crossings = size * (size + 1) // 2
    return vstack([density_operator(size), eye_array(size, crossings + size, k=crossings)]).tocsr()


def curvature_operator(size):
    """Second differences of the densities of the cells along both thresholds.

    Parameters
    ----------
    size : int

    Returns
    -------
    csr_array, shape (differences, n (n + 1) / 2)
    """
    cells = np.tril_indices(size)
    number = np.full((size, size), -1)
    number[cells] = np.arange(cells[0].size)
    triples = np.concatenate([
        np.stack([number[:, :-2], number[:, 1:-1], number[:, 2:]], axis=-1).reshape(-1, 3),
        np.stack([number[:-2], number[1:-1], number[2:]], axis=-1).reshape(-1, 3),
    ])
    triples = triples[(triples >= 0).all(axis=1)]
    rows = np.repeat(np.arange(len(triples)), 3)
    values = np.tile([1.0, -2.0, 1.0], len(triples))
    shape = (len(triples), cells[0].size)
    return coo_array((values, (rows, triples.ravel())), shape=shape).tocsr()


def _on_finer_grid(forces, coarse, fine):
    """Give each cell of a fine grid the force of the bounds of the coarse cell it lies in."""
    cell = np.arange(fine) * coarse // fine
    density, reversible = np.split(forces, [-coarse])
    return np.concatenate([
        lower_triangle(density, coarse)[np.ix_(cell, cell)][np.tril_indices(fine)],
        reversible[cell],
    ])


def reversible_differences(size, order):
    """Differences of the reversible parts, and a trace of the parts themselves.

    The trace lets the parts be zero where the voltage tells nothing of them.

    Parameters
    ----------
    size, order : int

    Returns
    -------
    csr_array, shape (2 n - order, n (n + 1) / 2 + n)
        Acts on the unknowns of the regression.
    """
    crossings = size * (size + 1) // 2
    differences = np.diff(np.eye(size), order, axis=0)
    parts = csr_array(np.vstack([differences, np.eye(size) / size**2]))
    return hstack([csr_array((2 * size - order, crossings)), parts]).tocsr()


def translation_operator(size):
    """First differences of the densities of the cells along the diagonal.

    Parameters
    ----------
    size : int

    Returns
    -------
    csr_array, shape (differences, n (n + 1) / 2)
    """
    i, j = np.tril_indices(size - 1)
    rows = np.tile(np.arange(i.size), 2)
    columns = np.concatenate([i * (i + 1) // 2 + j, (i + 1) * (i + 2) // 2 + j + 1])
    values = np.repeat([-1.0, 1.0], i.size)
    return coo_array((values, (rows, columns)), shape=(i.size, size * (size + 1) // 2)).tocsr()


class _Equations:
    """Normal equations of the regression, accumulated over blocks of samples, (2.7)."""

    def __init__(self, size, others, translation_weight):
        self.translation_weight = translation_weight
        unknowns = size * (size + 3) // 2
        self.size, self.count = size, 0
        self.quadratic, self.linear = csr_array((unknowns, unknowns)), np.zeros(unknowns)
        self.border, self.corner = np.zeros((unknowns, others)), np.zeros((others, others))
        self.border_linear, self.square = np.zeros(others), 0.0

    @classmethod
    def of(cls, voltage_v, output_um, levels_v, samples, transients, translation_weight):
        """Equations of the samples whose memory is known well enough."""
        history = everett_regression(voltage_v, levels_v).history
        if (history[samples] < 0).all():
            raise ValueError(
                "no sample lies where the voltage has been before: record at least one reversal"
            )
        numbers = np.arange(1, history.max() + 1)
        samples = samples[history[samples] >= 0]
        others = 1 + numbers.size + transients.shape[1]
        equations = cls(levels_v.size - 1, others, translation_weight)
        for start in range(0, samples.size, ROWS_AT_ONCE):
            block = samples[start : start + ROWS_AT_ONCE]
            rows = everett_regression(voltage_v, levels_v, block)
            others = np.column_stack([
                rows.history == 0, rows.history[:, None] == numbers, transients[block]
            ]).astype(float)
            equations.add(rows.matrix, others, output_um[block])
        return equations

    def add(self, matrix, others, output):
        """Add rows of the regression."""
        self.count += output.size
        self.quadratic = self.quadratic + matrix.T @ matrix
        self.linear += matrix.T @ output
        self.border += matrix.T @ others
        self.corner += others.T @ others
        self.border_linear += others.T @ output
        self.square += output @ output

    def solve(self, weight, multiplier=None):
        """Unknowns, coefficients of the other columns, and forces of the bounds."""
        roughness = weight * self._bending
        if self.translation_weight:
            roughness = roughness + self.translation_weight * self._sliding
        return nonnegative_minimum(
            self.quadratic / self.count + roughness,
            self.linear / self.count, self._bounded, self.border / self.count,
            self.corner / self.count, self.border_linear / self.count, multiplier,
        )

    @cached_property
    def _bounded(self):
        return bounded_operator(self.size)

    @cached_property
    def _bending(self):
        """Integral of the squares of the second derivatives; of a density over the squared range.

        The powers of the size turn differences into derivatives and the sum into the integral.
        """
        curvature = curvature_operator(self.size) @ self._bounded[: -self.size]
        bend = reversible_differences(self.size, 2)
        return self.size**6 * (curvature.T @ curvature) + self.size**5 * (bend.T @ bend)

    @cached_property
    def _sliding(self):
        """The same of the first derivatives along the diagonal."""
        translation = translation_operator(self.size) @ self._bounded[: -self.size]
        slope = reversible_differences(self.size, 1)
        return self.size**4 * (translation.T @ translation) + self.size**3 * (slope.T @ slope)

    def misfit(self, unknowns, beside):
        """Sum of the squares of what the regression leaves."""
        return self.square + (
            unknowns @ (self.quadratic @ unknowns + 2.0 * self.border @ beside - 2.0 * self.linear)
            + beside @ (self.corner @ beside - 2.0 * self.border_linear)
        )


def _best_weight(voltage_v, output_um, levels_v, samples, transients, translation_weight):
    """Weight that predicts every other half cell, and the forces of the bounds with it."""
    # Half cells around the levels are fitted, those around the middles held out.
    half_v = 0.5 * (levels_v[1] - levels_v[0])
    held_out = np.round((voltage_v[samples] - levels_v[0]) / half_v) % 2 == 1
    if not 0.1 < held_out.mean() < 0.9:
        # Samples taken by voltage may all lie on levels.
        held_out = np.arange(samples.size) % 2 == 1
    fitted, unseen = (
        _Equations.of(voltage_v, output_um, levels_v, samples[part], transients, translation_weight)
        for part in (~held_out, held_out)
    )
    trials = []
    multiplier = None
    for weight in SMOOTHING_WEIGHTS:
        unknowns, beside, multiplier = fitted.solve(weight, multiplier)
        trials.append((weight, unseen.misfit(unknowns, beside), multiplier))
    chance = 1.0 + np.sqrt(2.0 / max(unseen.count, 1))
    least = min(misfit for _, misfit, _ in trials)
    return next((weight, forces) for weight, misfit, forces in trials if misfit <= chance * least)
