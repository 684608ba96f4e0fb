# SPDX-License-Identifier: BSD-3-Clause
"""The hysteresis in front of a play, from the hysteresis of both together.

After a reversal, a play of width w follows a motion F only beyond w. Preisach hysteresis with an
Everett function F(alpha, beta), followed by a play, is therefore equivalent to Preisach hysteresis
with max(F - w, 0): quasistatic loops cannot distinguish them. For the inverse, F is the given
function plus w. Smaller motion is not visible; its gain is taken from where the play is taken up.
"""

from dataclasses import replace

import numpy as np

from piezo_models.hysteresis.preisach import PreisachModel

TAKEN_UP = 3.0
"""Motion in widths of the play after which it is taken up, for any resolution of the density."""


def without_play(hysteresis: PreisachModel, width_um: float) -> PreisachModel:
    """Return the hysteresis that is equivalent to the given one if a play follows it.

    It has the same grid. If the given one has more motion just after a reversal than the play
    allows, the excess is lost.
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
