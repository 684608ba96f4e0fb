# SPDX-License-Identifier: BSD-3-Clause
"""Density by smoothed non-negative least squares, for any recording and for large grids."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from piezo_common.arrays import FloatArray
from piezo_common.budget import has_time_for, while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_identification.estimators.hysteresis.density_estimate import (
    LINE,
    DensityEstimate,
    lower_triangle,
    per_volt,
)
from piezo_identification.estimators.hysteresis.equations import (
    HysteresisSegment,
    Penalties,
    equations_of_folds,
)
from piezo_identification.estimators.hysteresis.everett_regression import (
    everett_regression,
    visited_cells,
)
from piezo_identification.estimators.hysteresis.penalties import bounded_operator
from piezo_identification.estimators.hysteresis.play_fit import PlaySum, fit_plays
from piezo_identification.estimators.hysteresis.smoothing_choice import (
    WEIGHTS,
    PenaltyChoice,
    choose_penalties,
    refine_smoothing,
)

SAMPLES_PER_CELL = 4
"""Number of samples per cell above which the weights are also chosen on finer grids."""

CELLS_FOR_THE_WEIGHT = 30
"""Number of cells along a threshold for choosing the weights, which do not depend on the grid."""

LEAST_GAIN = 1.2
"""Factor by which plays must reduce the squared error on held-out branches, because the grid of
this comparison is too coarse for a density that would be as good on a finer one."""

PARTS_OF_CELLS = (1, 2, 4)
"""Divisions of a cell along each threshold that represent plays, whose density is narrow."""

ROUNDED = 0.1
"""Largest error due to the cells in small loops, relative to the noise. It returns at each
reversal, and a mode amplifies it."""

SMALL_LOOP = 0.1
"""Size of small loops, relative to the voltage range."""


LARGEST_REVERSIBLE_GAIN = 1.06
"""Largest factor by which the sum of squares may increase when the reversible part is omitted. A
density near its diagonal has nearly the same effect, and smoothing moves one into the other; see
`docs/decisions/reversible_part.md`."""


def smoothed_density(
    voltage_v: ArrayLike, output_um: FloatArray, levels_v: FloatArray,
    samples: NDArray[np.intp] | None = None, transients: FloatArray | None = None,
    smoothing_weight: float | None = None, level_count: int | None = None,
    translation_weight: float = 0.0,
) -> DensityEstimate:
    """Estimate the density from one stretch as `density_of_segments` does.

    Parameters
    ----------
    samples : ndarray of int, optional
        Increasing indices of the samples to fit; all by default.
    transients : ndarray, shape (N, k), optional
        Additional columns of the regression with free coefficients.
    """
    voltage_v = np.asarray(voltage_v, dtype=float)
    segment = HysteresisSegment(
        voltage_v, output_um, np.arange(voltage_v.size) if samples is None else samples,
        np.empty((voltage_v.size, 0)) if transients is None else transients)
    return density_of_segments(
        [segment], levels_v, level_count, smoothing_weight, translation_weight)


def density_of_segments(
    segments: Sequence[HysteresisSegment], levels_v: FloatArray, level_count: int | None = None,
    smoothing_weight: float | None = None, translation_weight: float = 0.0,
    is_line: bool = False, is_of_plays: bool = False,
) -> DensityEstimate:
    """Density that is non-negative and as smooth as the data allow.

    It minimises the mean squared residual of the regression on the Everett values, plus the
    weighted integral of the squared second derivatives of the density along both thresholds
    (voltages in units of the range). The reversible part on the diagonal is smoothed in the same
    way, as a function of the voltage; it is omitted if the data do not require it. Everything is
    sparse: Everett values and reversible part are the unknowns, and the density is the mixed second
    difference of the Everett values without the reversible part.

    Parameters
    ----------
    segments : sequence of HysteresisSegment
        Segments of one stage, each with its own offset; that of the model is the first one with a
        known past. For their start see `everett_regression`.
    levels_v : ndarray, shape (n + 1,)
        Edges of the cells, uniform and increasing.
    level_count : int, optional
        Number of equal voltage steps that define visited cells; n by default.
    smoothing_weight : float, optional
        By default the largest that predicts held-out branches as well as any, see
        `smoothing_choice.choose_penalties`.
    translation_weight : float
        Weight of the integral of the squared first derivative of the density along the diagonal. A
        small weight makes the density outside the visited cells equal to that of equally wide loops
        elsewhere, where the curvature alone would extrapolate linearly.
    is_line : bool
        True if the voltage shows only a line.
    is_of_plays : bool
        True if an earlier estimate was a density about a sum of plays.

    Returns
    -------
    DensityEstimate
        Its method is `LINE` if a line predicts held-out data as well as any density.

    Raises
    ------
    ValueError
        If no sample can be used.
    """
    size = levels_v.size - 1
    level_count = size if level_count is None else level_count
    seen = np.any([
        visited_cells(segment.voltage_v, np.linspace(levels_v[0], levels_v[-1], level_count + 1),
                      segment.samples)
        for segment in segments], axis=0)
    whole_plane = bool(seen[np.tril_indices(level_count)].all())
    plays, parts, multiplier, is_enough = None, 1, None, is_line
    if is_line:
        penalties = Penalties(0.0)
    elif smoothing_weight is None:
        choice, plays, segments, parts = _choice_for(
            segments, levels_v, translation_weight, is_of_plays)
        is_fine = plays is None and (whole_plane or _many(segments, size))
        if size % 2 == 0 and size >= 2 * CELLS_FOR_THE_WEIGHT and not (
                is_fine and has_time_for("a density of more cells", WEIGHTS)):
            # A smooth density needs fewer cells.
            levels_v, size = levels_v[::2], size // 2
            parts = parts if plays is None else 2 * parts
        choice = _on_finer_grids(segments, levels_v, choice, whole_plane, plays)
        penalties, multiplier, is_enough = choice.penalties, choice.forces, choice.is_enough
    else:
        penalties = Penalties(smoothing_weight, translation_weight)
    about = None if plays is None else plays.unknowns(size)
    [equations] = equations_of_folds(segments, levels_v, about=about)
    is_line = is_enough and plays is None
    if is_line:
        unknowns, coefficients = equations.solve_line()
    elif is_enough:
        unknowns = 0.0 * equations.linear
        coefficients = equations.coefficients(unknowns)
    else:
        unknowns, coefficients, multiplier = equations.solve(penalties, multiplier)
        with while_time_lasts("a density of fewer parts"):
            without = equations.solve(replace(penalties, is_reversible=False), multiplier)[:2]
            if equations.misfit(*without) < (
                    LARGEST_REVERSIBLE_GAIN * equations.misfit(unknowns, coefficients)):
                penalties = replace(penalties, is_reversible=False)
                unknowns, coefficients = without
    # The first column of a segment is the offset of its samples with known past.
    known = np.flatnonzero(np.diag(equations.corner)[equations.offset_columns] > 0.0)
    offset_um = float(coefficients[equations.offset_columns[known[0]]]) if known.size else 0.0
    if is_line:
        return DensityEstimate(
            LINE, levels_v[[0, -1]], np.zeros((1, 1)), offset_um, np.ones((1, 1), dtype=bool),
            reversible_um_per_v=np.array([
                unknowns[-size:].mean() * size / (levels_v[-1] - levels_v[0])]))
    levels_v = np.linspace(levels_v[0], levels_v[-1], parts * size + 1)
    density, reversible = per_volt(bounded_operator(size) @ unknowns, size, levels_v)
    if not penalties.is_reversible:
        reversible = 0.0 * reversible
    if plays is not None:
        of_plays = per_volt(
            bounded_operator(parts * size) @ plays.unknowns(parts * size), parts * size, levels_v)
        cell = np.arange(parts * size) // parts
        square = np.ix_(cell, cell)
        density = _added(np.tril(density[square]), of_plays[0],
                         _mean_in_cells(of_plays[0], parts)[square])
        reversible = _added(reversible[cell], of_plays[1],
                            of_plays[1].reshape(size, parts).mean(axis=1)[cell])
    cell = np.arange(parts * size) * level_count // (parts * size)
    return DensityEstimate(
        "smoothed non-negative least squares",
        levels_v, np.maximum(density, 0.0), offset_um, np.tril(seen[np.ix_(cell, cell)]),
        smoothing_weight=penalties.smoothing, reversible_um_per_v=np.maximum(reversible, 0.0),
        translation_weight=penalties.translation, plays=plays,
    )


def _mean_in_cells(density: FloatArray, parts: int) -> FloatArray:
    """Return the mean of a density in cells that are divided; those on the diagonal are halved."""
    weight = np.tri(len(density)) - 0.5 * np.eye(len(density))
    size = len(density) // parts
    divided = (size, parts, size, parts)
    summed = (weight * density).reshape(divided).sum(axis=(1, 3))
    return summed / np.maximum(weight.reshape(divided).sum(axis=(1, 3)), 1.0 / parts)


def _added(more: FloatArray, of_plays: FloatArray, mean_in_cell: FloatArray) -> FloatArray:
    """Add to the narrow densities of plays; negative additions are in proportion within a cell.

    Their mean in a divided cell counts: narrow plays belong to the reversible part of whole cells.
    """
    part = np.divide(more, mean_in_cell, out=np.zeros_like(more), where=mean_in_cell > 0.0)
    return of_plays * (1.0 + np.clip(part, -1.0, 0.0)) + np.maximum(more, 0.0)


_Choice = tuple[PenaltyChoice, PlaySum | None, Sequence[HysteresisSegment], int]
"""Weights, plays, segments without the output of these, and the divisions of a cell."""


def _choice_for(segments: Sequence[HysteresisSegment], levels_v: FloatArray, translation: float,
                is_of_plays: bool) -> _Choice:
    """Choose the weights, and whether the density is smoothed about a sum of plays.

    It is if that predicts held-out branches better, or as a known sum of plays alone does.
    """
    about = _about_plays(segments, levels_v, translation) if is_of_plays else None
    if about is not None and about[0].is_enough:
        return about
    coarse_v = _coarse_v(levels_v)
    choice = choose_penalties(segments, coarse_v, translation)
    without = choice, None, segments, 1
    if choice.is_enough:
        return without
    with while_time_lasts("a density about a sum of plays", WEIGHTS):
        check_cancelled()
        about = about or _about_plays(segments, levels_v, translation)
        if about is not None and LEAST_GAIN * about[0].misfit < choice.misfit:
            return about
    return without


def _coarse_v(levels_v: FloatArray) -> FloatArray:
    """Return the edges of the cells for which the weights are chosen, (m + 1,)."""
    return np.linspace(levels_v[0], levels_v[-1], min(levels_v.size - 1, CELLS_FOR_THE_WEIGHT) + 1)


def _about_plays(segments: Sequence[HysteresisSegment], levels_v: FloatArray,
                 translation: float) -> _Choice | None:
    """Choose the weights of a density about a sum of plays; None if there are too few samples.

    The output of the plays is subtracted, and the cells are divided to represent them.
    """
    plays = fit_plays(segments, levels_v)
    if plays is None:
        return None
    parts, coarse_v = _parts_for(levels_v.size - 1, plays), _coarse_v(levels_v)
    relieved = [replace(segment, output_um=segment.output_um - _output_um(
        segment, levels_v, plays, parts)) for segment in segments]
    return choose_penalties(relieved, coarse_v, translation, plays.unknowns(
        coarse_v.size - 1)), plays, relieved, parts


def _parts_for(size: int, plays: PlaySum) -> int:
    """Return the divisions of a cell in which plays are represented accurately enough."""
    for parts in PARTS_OF_CELLS[:-1]:
        if _rounded_um(plays, parts * size) < ROUNDED * plays.noise_um:
            return parts
    return PARTS_OF_CELLS[-1]


def _rounded_um(plays: PlaySum, size: int) -> float:
    """Return the RMS error at the centres of the cells that small loops pass.

    There, the Everett function of the cells is the mean of its values at their corners.
    """
    crossings = size * (2 * size + 1)
    everett_um = lower_triangle(plays.unknowns(2 * size)[:crossings], 2 * size)
    errors_um = []
    for apart in range(1, max(2, round(SMALL_LOOP * size))):
        # Level 2 a belongs to row 2 a - 1.
        upper = 2 * np.arange(apart, size)
        lower = upper - 2 * apart
        corners_um = sum(everett_um[upper + row, lower + column]
                         for row in (-1, 1) for column in (0, 2))
        errors_um.append(everett_um[upper, lower + 1] - 0.25 * corners_um)
    return float(np.sqrt(np.mean(np.concatenate(errors_um) ** 2)))


def _output_um(segment: HysteresisSegment, levels_v: FloatArray, plays: PlaySum,
               parts: int) -> FloatArray:
    """Return the output of plays, (N,), represented in divided cells; 0 at samples not fitted."""
    size = parts * (levels_v.size - 1)
    finer_v = np.linspace(levels_v[0], levels_v[-1], size + 1)
    regression = everett_regression(segment.voltage_v, finer_v, segment.samples)
    output_um = np.zeros(segment.voltage_v.size)
    output_um[segment.samples] = regression.output_um(plays.unknowns(size))
    return output_um


def _on_finer_grids(
    segments: Sequence[HysteresisSegment], levels_v: FloatArray, choice: PenaltyChoice,
    whole_plane: bool, plays: PlaySum | None,
) -> PenaltyChoice:
    """Choose the smoothing again on twice as many cells if the data allow.

    They do if the whole plane is visited, or there are several samples per cell. Then the active
    bounds are found on grids twice as fine each time, which costs little.
    """
    size = levels_v.size - 1
    cells = min(size, CELLS_FOR_THE_WEIGHT)
    with while_time_lasts("the smoothing on finer cells", WEIGHTS):
        while 2 * cells < size and not choice.is_enough:
            check_cancelled()
            finer_v = np.linspace(levels_v[0], levels_v[-1], 2 * cells + 1)
            about = None if plays is None else plays.unknowns(2 * cells)
            forces = _on_finer_grid(choice.forces, cells, 2 * cells)
            if (whole_plane or _many(segments, 2 * cells)) and cells == CELLS_FOR_THE_WEIGHT:
                choice = refine_smoothing(segments, finer_v, choice, forces, about)
            else:
                [equations] = equations_of_folds(segments, finer_v, about=about)
                *_, forces = equations.solve(choice.penalties, forces)
                choice = replace(choice, forces=forces)
            cells *= 2
    return replace(choice, forces=_on_finer_grid(choice.forces, cells, size))


def _on_finer_grid(forces: FloatArray, coarse: int, fine: int) -> FloatArray:
    """Give each cell of a fine grid the multiplier of the coarse cell that contains it."""
    cell = np.arange(fine) * coarse // fine
    density, reversible = np.split(forces, [-coarse])
    return np.concatenate([
        lower_triangle(density, coarse)[np.ix_(cell, cell)][np.tril_indices(fine)],
        reversible[cell],
    ])


def _many(segments: Sequence[HysteresisSegment], size: int) -> bool:
    """Return whether there are several samples per cell of a grid."""
    cells = size * (size + 1) // 2
    return sum(len(segment.samples) for segment in segments) >= SAMPLES_PER_CELL * cells
