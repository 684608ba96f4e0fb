# SPDX-License-Identifier: BSD-3-Clause
"""Picture of a path: as commanded and as the axes do it, the error, the voltages."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from piezo_common.picture_style import CURVES, REFERENCE, label, new_figure, thinned

if TYPE_CHECKING:
    from piezo_controller.axes.path_plan import PathPlan

SHOWN: dict[str, dict[str, Any]] = {
    "none": {**CURVES[1], "label": "no inverse"},
    "coupled": {**CURVES[0], "linewidth": 0.8, "label": "coupled inverse"}}


def path_figure(plan: "PathPlan") -> Figure:
    """Draw a planned path of the two axes that it moves farthest, its error and the voltages."""
    path, prediction = plan.path, plan.prediction
    first, second = np.sort(np.argsort(np.ptp(path.position_um, axis=0), kind="stable")[-2:])
    figure = new_figure(height_in=5.0, width_in=8.0)
    grid = figure.add_gridspec(3, 2)
    plane = figure.add_subplot(grid[:, 0])
    plane.plot(*thinned(path.position_um[:, first], path.position_um[:, second]), **REFERENCE)
    for inverse, style in SHOWN.items():
        done_um = prediction.displacement_um[inverse]
        plane.plot(*thinned(done_um[:, first], done_um[:, second]), **style)
    plane.set_aspect("equal")
    label(plane, f"{path.axes[first]} (um)", f"{path.axes[second]} (um)", str(path))
    # Beside the path, which fills its axes.
    figure.legend(*plane.get_legend_handles_labels(), loc="outside lower left", ncols=3)
    for row, inverse in enumerate(SHOWN):
        error = figure.add_subplot(grid[row, 1])
        left_nm = 1e3 * (path.position_um - prediction.displacement_um[inverse])
        for axis, column, style in zip(path.axes, left_nm.T, CURVES, strict=False):
            error.plot(*thinned(path.time_s, column), **style, label=axis)
        label(error, "time (s)", "error (nm)", SHOWN[inverse]["label"])
        error.legend(loc="upper right")
    voltage = figure.add_subplot(grid[2, 1])
    for axis, column, style in zip(path.axes, plan.voltage_v.T, CURVES, strict=False):
        voltage.plot(*thinned(path.time_s, column), **style, label=axis)
    label(voltage, "time (s)", "voltage (V)", "voltages of the coupled inverse")
    voltage.legend(loc="upper right")
    return figure
