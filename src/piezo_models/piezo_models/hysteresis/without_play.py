# SPDX-License-Identifier: BSD-3-Clause
"""The hysteresis in front of a play, from the hysteresis of both together.

After a reversal, a play of width w follows a motion F only beyond w. So Preisach hysteresis with an
Everett function F(alpha, beta) and a play behind it are together Preisach hysteresis with
max(F - w, 0): quasistatic loops do not tell the two apart. Backwards, F is the given function plus
w; of smaller motion nothing is seen, and its gain is taken for that at which the play is taken up.
"""

from dataclasses import replace

import numpy as np

from piezo_models.hysteresis.preisach import PreisachModel

TAKEN_UP = 3.0
"""Widths of a motion by which the play is taken up, whatever the resolution of the density."""


def without_play(hysteresis: PreisachModel, width_um: float) -> PreisachModel:
    """Return the hysteresis that does what the given one does with a play behind it.

    Parameters
    ----------
    width_um : float
        Of the play.

    Returns
    -------
    PreisachModel
        On the same grid. Where the given one has more motion just after a reversal than the play
        allows, this is lost.
    """
    levels_v, cell_v = hysteresis.levels_v, hysteresis.cell_width_v
    seen_um = hysteresis.everett_um(levels_v[:, None], levels_v[None, :]) + width_um
    cells = np.maximum(np.subtract.outer(np.arange(levels_v.size), np.arange(levels_v.size)), 0)
    apart = np.arange(1, levels_v.size)
    mean_um = np.array([np.mean(np.diagonal(seen_um, -each)) for each in apart])
    early = mean_um <= max(TAKEN_UP * width_um, mean_um[0])
    taken_up = 1 + int(np.argmin((mean_um / apart)[early]))
    unseen_um = mean_um[taken_up - 1] / taken_up * cells
    everett_um = np.where(cells <= taken_up, unseen_um, seen_um)
    within = everett_um[1:, :-1] - everett_um[:-1, :-1] - everett_um[1:, 1:] + everett_um[:-1, 1:]
    return replace(
        hysteresis, density_um_per_v2=np.maximum(np.tril(within, -1), 0.0) / cell_v**2,
        reversible_um_per_v=np.diagonal(everett_um, -1) / cell_v)
