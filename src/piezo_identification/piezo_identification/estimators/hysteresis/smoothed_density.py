# SPDX-License-Identifier: BSD-3-Clause
"""The density by smoothed non-negative least squares, on any recording and on large grids."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.estimators.hysteresis.density_estimate import (
    LINE,
    DensityEstimate,
    lower_triangle,
)
from piezo_identification.estimators.hysteresis.equations import (
    HysteresisSegment,
    Penalties,
    equations_of_folds,
)
from piezo_identification.estimators.hysteresis.everett_regression import visited_cells
from piezo_identification.estimators.hysteresis.penalties import bounded_operator
from piezo_identification.estimators.hysteresis.smoothing_choice import (
    PenaltyChoice,
    choose_penalties,
    refine_smoothing,
)

SAMPLES_PER_CELL = 4
"""So many samples tell more than the few cells on which the weights are chosen can follow."""

CELLS_FOR_THE_WEIGHT = 30
"""Cells along a threshold on which the weights are chosen: they mean the same on any grid."""


def smoothed_density(
    voltage_v: ArrayLike, output_um: FloatArray, levels_v: FloatArray,
    samples: NDArray[np.intp] | None = None, transients: FloatArray | None = None,
    smoothing_weight: float | None = None, level_count: int | None = None,
    translation_weight: float | None = None,
) -> DensityEstimate:
    """Density that is nowhere negative and as smooth as the data allow.

    Minimises the mean square of what the regression on the Everett values leaves, and the weighted
    integral of the squares of the density's second derivatives along both thresholds (voltages in
    units of the range). The reversible part on the diagonal is smoothed alike, as a function of the
    voltage; it is left out where the data do not ask for it. Everything is sparse: Everett values
    and reversible part are the unknowns, the density is the mixed second difference of what the
    second leaves of the first.

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
        By default the largest that predicts branches held out as well as any, see
        `smoothing_choice.choose_penalties`.
    level_count : int, optional
        Number of equal steps of voltage by which a cell counts as visited; n by default.
    translation_weight : float, optional
        Weight of the integral of the squares of the density's first derivative along the diagonal.
        A small one lets the density outside the visited cells be that of equally wide loops
        elsewhere, where the curvature alone would go on straight. By default 0 where every cell is
        visited or the smoothing is given, and chosen like the smoothing elsewhere.

    Returns
    -------
    DensityEstimate

    Raises
    ------
    ValueError
        If no sample can be used.
    """
    voltage_v = np.asarray(voltage_v, dtype=float)
    segment = HysteresisSegment(
        voltage_v, output_um, np.arange(voltage_v.size) if samples is None else samples,
        np.empty((voltage_v.size, 0)) if transients is None else transients)
    return density_of_segments(
        [segment], levels_v, level_count, smoothing_weight, translation_weight)


LARGEST_TRANSLATION_COST = 1.3
"""Factor by which a weight on the change along the diagonal that was chosen on few cells may raise
the sum of squares on all of them."""

LARGEST_REVERSIBLE_GAIN = 1.06
"""Factor by which the sum of squares may rise where the reversible part is left out. A density near
its diagonal does nearly what such a part does, and smoothing moves one into the other; see
`docs/decisions/reversible_part.md`."""


def density_of_segments(
    segments: Sequence[HysteresisSegment], levels_v: FloatArray, level_count: int | None = None,
    smoothing_weight: float | None = None, translation_weight: float | None = None,
    is_line: bool = False,
) -> DensityEstimate:
    """Estimate the density as `smoothed_density` does, from several segments of one stage.

    Parameters
    ----------
    segments : sequence of HysteresisSegment
        Each has an offset of its own; that of the model is the first one of a known past.
    levels_v : ndarray, shape (n + 1,)
    level_count : int, optional
    smoothing_weight, translation_weight : float, optional
        As of `smoothed_density`.
    is_line : bool
        The voltage shows no more than a line.

    Returns
    -------
    DensityEstimate
        Of method `LINE` where a line predicts what is held out as well as any density.
    """
    size = levels_v.size - 1
    level_count = size if level_count is None else level_count
    seen = np.any([
        visited_cells(segment.voltage_v, np.linspace(levels_v[0], levels_v[-1], level_count + 1))
        for segment in segments], axis=0)
    cell = np.arange(size) * level_count // size
    visited = np.tril(seen[np.ix_(cell, cell)])
    whole_plane = bool(seen[np.tril_indices(level_count)].all())
    if translation_weight is None and (whole_plane or smoothing_weight is not None):
        translation_weight = 0.0
    multiplier = None
    if is_line:
        penalties = Penalties(0.0)
    elif smoothing_weight is None:
        choice = _penalties_for(segments, levels_v, translation_weight, whole_plane)
        penalties, multiplier, is_line = choice.penalties, choice.forces, choice.is_line
    else:
        penalties = Penalties(smoothing_weight, translation_weight or 0.0)
    [equations] = equations_of_folds(segments, levels_v)
    if is_line:
        unknowns, beside = equations.solve_line()
    else:
        unknowns, beside, _ = equations.solve(penalties, multiplier)
        if translation_weight is None and penalties.translation:
            # Loops that were alike on the coarse grid need not be on the fine one.
            free = choice.without_translation
            others = equations.solve(free, multiplier)[:2]
            if equations.misfit(unknowns, beside) > (
                    LARGEST_TRANSLATION_COST * equations.misfit(*others)):
                penalties, (unknowns, beside) = free, others
        without = equations.solve(replace(penalties, is_reversible=False), multiplier)[:2]
        if equations.misfit(*without) < (
                LARGEST_REVERSIBLE_GAIN * equations.misfit(unknowns, beside)):
            penalties, (unknowns, beside) = replace(penalties, is_reversible=False), without
    bounded = np.maximum(bounded_operator(size) @ unknowns, 0.0)
    if not penalties.is_reversible:
        bounded[-size:] = 0.0
    density, reversible = np.split(bounded, [-size])
    width_v = (levels_v[-1] - levels_v[0]) / size
    # The first column of a segment is the offset of its samples of a known past.
    known = np.flatnonzero(np.diag(equations.corner)[equations.offset_columns] > 0.0)
    offset_um = beside[equations.offset_columns[known[0]]] if known.size else 0.0
    if is_line:
        return DensityEstimate(
            LINE, levels_v[[0, -1]], np.zeros((1, 1)), float(offset_um),
            np.ones((1, 1), dtype=bool),
            reversible_um_per_v=np.array([reversible.mean() / width_v]))
    return DensityEstimate(
        "smoothed non-negative least squares", levels_v,
        lower_triangle(density, size) / width_v**2, float(offset_um), visited,
        smoothing_weight=penalties.smoothing, reversible_um_per_v=reversible / width_v,
        translation_weight=penalties.translation,
    )


def _penalties_for(
    segments: Sequence[HysteresisSegment], levels_v: FloatArray, translation: float | None,
    whole_plane: bool,
) -> PenaltyChoice:
    """Choose the weights on few cells, and the smoothing anew on twice as many if the data allow.

    They do where the whole plane is visited, or there are several samples for each cell.

    The bounds that hold are then found on grids twice as fine each time, where that costs little.
    """
    size = levels_v.size - 1
    cells = min(size, CELLS_FOR_THE_WEIGHT)
    choice = choose_penalties(
        segments, np.linspace(levels_v[0], levels_v[-1], cells + 1), translation)
    while 2 * cells < size and not choice.is_line:
        finer_v = np.linspace(levels_v[0], levels_v[-1], 2 * cells + 1)
        forces = _on_finer_grid(choice.forces, cells, 2 * cells)
        if (whole_plane or _many(segments, 2 * cells)) and cells == CELLS_FOR_THE_WEIGHT:
            choice = refine_smoothing(segments, finer_v, choice, forces)
        else:
            [equations] = equations_of_folds(segments, finer_v)
            *_, forces = equations.solve(choice.penalties, forces)
            choice = replace(choice, forces=forces)
        cells *= 2
    return replace(choice, forces=_on_finer_grid(choice.forces, cells, size))


def _on_finer_grid(forces: FloatArray, coarse: int, fine: int) -> FloatArray:
    """Give each cell of a fine grid the force of the bounds of the coarse cell it lies in."""
    cell = np.arange(fine) * coarse // fine
    density, reversible = np.split(forces, [-coarse])
    return np.concatenate([
        lower_triangle(density, coarse)[np.ix_(cell, cell)][np.tril_indices(fine)],
        reversible[cell],
    ])


def _many(segments: Sequence[HysteresisSegment], size: int) -> bool:
    """Tell whether there are several samples for each cell of a grid."""
    cells = size * (size + 1) // 2
    return sum(len(segment.samples) for segment in segments) >= SAMPLES_PER_CELL * cells
