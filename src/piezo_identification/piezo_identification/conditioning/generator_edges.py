# SPDX-License-Identifier: BSD-3-Clause
"""When a generator that runs freely changed its level, between the samples that show it."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.waveforms import SquareWave

FEWEST_EDGES = 6
"""Changes of the level that tell period, duty and the instant of the first one beyond doubt."""

LATE_EDGE = 0.1
"""Part of a sample period by which the edges of a generator may miss one period and one duty."""


def free_running_level(wave: SquareWave) -> FloatArray | None:
    """Return levels, held for a sample period each, that act as those of a free-running generator.

    A generator's step comes a part of a sample period before the sample that shows it. The levels
    held before and after this sample are changed, so that area and centre of what that adds are the
    same: what follows a step then differs by the third power of the sample period only.

    Parameters
    ----------
    wave : SquareWave
        As sampled.

    Returns
    -------
    ndarray, shape (N,), or None
        None where one period and one duty do not explain the steps, or the period is a whole
        number of samples.
    """
    level, steps = wave.level, wave.steps
    if steps.size < FEWEST_EDGES or np.all(steps[2:] - steps[:-2] == steps[2] - steps[0]):
        return None
    edges = _edges_of_generator(steps)
    if edges is None:
        return None
    earlier, change = steps - edges, level[steps] - level[steps - 1]
    result = level.copy()
    result[steps - 1] += 0.5 * (earlier + earlier**2) * change
    result[steps] += 0.5 * (earlier - earlier**2) * change
    return result


def _edges_of_generator(steps: NDArray[np.intp]) -> FloatArray | None:
    """Find the edges of one period and duty, in samples; None if there are none.

    An edge is seen at the first sample after it. So many such bounds leave little room, of which
    the middle is taken: the edges that keep farthest from their bounds, by linear programming.
    """
    turn = np.arange(steps.size)
    columns = np.column_stack([turn // 2, turn % 2 == 0, turn % 2 == 1]).astype(float)
    margin = np.ones((steps.size, 1))
    found = linprog(
        [0.0, 0.0, 0.0, -1.0],
        A_ub=np.vstack([np.hstack([columns, margin]), np.hstack([-columns, margin])]),
        b_ub=np.concatenate([steps, 1 - steps]).astype(float),
        bounds=[(None, None)] * 3 + [(-LATE_EDGE, None)])
    return np.clip(columns @ found.x[:3], steps - 1, steps) if found.success else None
