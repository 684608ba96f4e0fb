# SPDX-License-Identifier: BSD-3-Clause
"""The density is hatched where no recording visited it, and nowhere else."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from piezo_common.picture_style import new_figure
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.model_pictures import density_on
from piezo_models.model_summary import visited_fraction

CELLS = 40


def pixels(visited):
    density = np.tril(np.full((CELLS, CELLS), 0.004))
    figure = new_figure()
    axes = figure.subplots()
    density_on(axes, PreisachModel(0.0, 100.0, density, 0.0), visited)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())[..., :3] / 255.0
    places = axes.transData.transform([(20.0, 90.0), (40.0, 50.0)]).astype(int)
    return [image[image.shape[0] - y - 8 : image.shape[0] - y + 8, x - 8 : x + 8]
            for x, y in places]


def test_cells_that_no_recording_visited_are_hatched():
    row, column = np.indices((CELLS, CELLS))
    visited = (row >= column) & (row - column < CELLS // 2)
    far, near = pixels(visited)
    assert np.ptp(far, axis=(0, 1)).max() > 0.2
    assert np.ptp(near, axis=(0, 1)).max() < 0.05
    everywhere, _ = pixels(np.tril(np.ones((CELLS, CELLS), dtype=bool)))
    assert np.ptp(everywhere, axis=(0, 1)).max() < 0.05


def test_the_visited_part_counts_half_of_the_cells_on_the_diagonal():
    visited = np.eye(2, dtype=bool)
    assert visited_fraction(visited) == pytest.approx(0.5)
