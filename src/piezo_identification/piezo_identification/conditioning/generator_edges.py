# SPDX-License-Identifier: BSD-3-Clause
"""When a generator that runs freely changed its level, between the samples that show it."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.waveforms import SquareWave

FEWEST_EDGES = 6
"""Changes of the level that tell period, duty and the instant of the first one beyond doubt."""

LATE_EDGE = 0.1
"""Part of a sample period by which the edges of a generator may miss one period and one duty."""


@dataclass(frozen=True, eq=False)
class GeneratorEdges:
    """Edges of a generator, and what the rows leave open of them.

    Parameters
    ----------
    early : ndarray, shape (N,)
        Part of a sample period by which each change of the level came before the sample that shows
        it; 0 where the level stays.
    directions : ndarray, shape (N, 3)
        Derivatives of these parts by the period and by the duty, which leave their mean as it is,
        and by the instant of all edges, which no record tells from a delay.
    phase_room : float
        Part of a sample period by which all edges may be earlier or later together.
    """

    early: FloatArray
    directions: FloatArray
    phase_room: float


def generator_edges(wave: SquareWave) -> GeneratorEdges | None:
    """Find the edges of a generator of one period and duty.

    An edge is seen at the first sample after it. So many such bounds leave little room, of which
    the middle is taken: the edges that keep farthest from their bounds, by linear programming.

    Parameters
    ----------
    wave : SquareWave
        As sampled.

    Returns
    -------
    GeneratorEdges or None
        None where one period and one duty do not explain the steps, or the period is a whole
        number of samples.
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
    """Return levels, held for a sample period each, that act as a generator's on what is slow.

    The levels held before and after the sample that shows a step are changed, so that area and
    centre of what that adds are those of the step between the samples: what follows it differs by
    the third power of the sample period only.

    Parameters
    ----------
    wave : SquareWave
        As sampled.

    Returns
    -------
    ndarray, shape (N,), or None
        None where `generator_edges` finds none.
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
