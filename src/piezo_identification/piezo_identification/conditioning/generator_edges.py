# SPDX-License-Identifier: BSD-3-Clause
"""Find when a free-running generator changed its level, between the samples."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.optimize import linprog

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.waveforms import SquareWave

FEWEST_EDGES = 6
"""Fewest changes of the level for which period, duty and time of the edges are estimated."""

EARLY_EDGE = "early_edge"
"""Column of a recording with `GeneratorEdges.early`, by which its simulation moves the edges."""

INSTANT = 2
"""Column of `GeneratorEdges.directions` in which all edges move alike."""

STEP = 1e-3
"""Step of numerical derivatives by the edges, in sample periods."""

LATE_EDGE = 0.1
"""Largest deviation of the edges from a constant period and duty, in sample periods."""


@dataclass(frozen=True, eq=False)
class GeneratorEdges:
    """Edges of a generator, and their remaining uncertainty."""

    early: FloatArray
    """Time from each change of the level to the sample that shows it, in sample periods, (N,); 0
    where the level does not change."""
    directions: FloatArray
    """Derivatives of `early` by period and duty, without effect on its mean, and by the time of all
    edges, which is indistinguishable from a delay, (N, 3)."""
    phase_room: float
    """Shift of all edges that the samples allow, in sample periods, either way."""


def generator_edges(wave: SquareWave) -> GeneratorEdges | None:
    """Find the edges of a generator with constant period and duty.

    An edge shows in the first sample after it, which bounds its time. Linear programming finds the
    period, duty and time for which all edges are farthest from their bounds. The result is None if
    constant period and duty do not explain the steps, or the period is a whole number of samples.
    """
    steps = wave.steps
    if steps.size < FEWEST_EDGES or np.all(steps[2:] - steps[:-2] == steps[2] - steps[0]):
        return None
    turn = np.arange(steps.size)
    columns = np.column_stack([turn // 2, turn % 2 == 0, turn % 2 == 1]).astype(float)
    margin = np.ones((steps.size, 1))
    found = linprog(
        [0.0, 0.0, 0.0, -1.0],
        A_ub=np.vstack([np.hstack([columns, margin]), np.hstack([-columns, margin])]),
        b_ub=np.concatenate([steps, 1 - steps]).astype(float),
        bounds=[(None, None)] * 3 + [(-LATE_EDGE, None)])
    if not found.success:
        return None
    early, directions = np.zeros(wave.level.size), np.zeros((wave.level.size, 3))
    early[steps] = np.clip(steps - columns @ found.x[:3], 0.0, 1.0)
    directions[steps, :2] = columns[:, :2].mean(axis=0) - columns[:, :2]
    directions[steps, 2] = -1.0
    return GeneratorEdges(early, directions, max(float(found.x[3]), 0.0))


def free_running_level(wave: SquareWave) -> FloatArray | None:
    """Return held levels, (N,), that affect slow dynamics as those of the generator do.

    The two levels around a step are changed so that area and centroid of the change are those of
    the step between the samples. The error of a slow response is then of third order in the sample
    period. The result is None if `generator_edges` returns None.
    """
    edges = generator_edges(wave)
    if edges is None:
        return None
    level, steps = wave.level, wave.steps
    earlier, change = edges.early[steps], level[steps] - level[steps - 1]
    result = level.copy()
    result[steps - 1] += 0.5 * (earlier + earlier**2) * change
    result[steps] += 0.5 * (earlier - earlier**2) * change
    return result


def moved_between_rows(held: FloatArray, early: FloatArray, is_smooth: bool) -> FloatArray:
    """Move changes of a signal to times between the rows that it is held for.

    A change becomes several changes at the parts of the row before it, weighted as an interpolation
    weights values there. A linear system, whose response is smooth, then responds as to the change
    itself.

    The signal, (N parts,), is given in equal parts of its rows, and `early`, (N,), is the time from
    each change to the row that shows it, in rows; 0 in all other rows. If only a linear system
    follows (`is_smooth`), all parts within the row are weighted, which overshoots. Otherwise, the
    signal rises or falls in the part of the change.
    """
    parts = held.size // early.size
    rows = np.flatnonzero(early)
    if is_smooth:
        nodes = np.arange(1, parts) / parts
        weights = BarycentricInterpolator(nodes, np.eye(nodes.size))(early[rows])
    else:
        nodes = np.arange(1, parts + 1) / parts
        weights = np.maximum(1.0 - parts * np.abs(early[rows, None] - nodes), 0.0)
    before, after = held[parts * rows - 1], held[parts * rows]
    # A part contains the changes at its own node and at all earlier ones.
    reached = np.cumsum(weights[:, ::-1], axis=1)[:, ::-1]
    moved = held.copy()
    for part in range(nodes.size):
        moved[parts * rows - 1 - part] = before + reached[:, part] * (after - before)
    return moved
