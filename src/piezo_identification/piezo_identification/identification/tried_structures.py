# SPDX-License-Identifier: BSD-3-Clause
"""The structures that the fit of the whole model tried, as a table and as a picture."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from piezo_identification.estimators.estimate import DECISIVE
from piezo_identification.fitting.whole_model import WholeFit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Tried = Sequence[tuple[str, WholeFit]]
"""What was changed, and the fit, in the order in which they were tried."""


def structure_table(tried: Tried, best: WholeFit) -> str:
    """Return a table of all fits for the user, with the best one marked."""
    first = tried[0][1]
    lines = [f"{'structure':45}{'parameters':>12}{'evidence':>12}  residual (um)"]
    for change, fit in tried:
        residual_um = ", ".join(
            f"{np.sqrt(np.mean(residual**2)):.3g}" for residual, _ in fit.residual_um)
        lines.append(f"{change:45}{fit.numbers:12d}{fit.evidence_over(first):12.1f}  {residual_um}"
                     f"{'  <- written' if fit is best else ''}")
    return "\n".join(lines)


def structure_figure(tried: Tried, best: WholeFit) -> "Figure":
    """Draw by how much the evidence of each fit is lower than that of the best one.

    A filled mark is the best one, which is written.
    """
    from piezo_common.picture_style import BLUE, label, new_figure

    figure = new_figure(height_in=0.8 + 0.22 * len(tried))
    axes = figure.subplots()
    for place, (_, fit) in enumerate(tried):
        axes.plot(best.evidence_over(fit), place, color=BLUE, marker="o",
                  fillstyle="full" if fit is best else "none")
    axes.set_xscale("symlog", linthresh=DECISIVE)
    axes.set_yticks(range(len(tried)), [change for change, _ in tried])
    axes.invert_yaxis()
    label(axes, "log-evidence below the best (1)")
    return figure
