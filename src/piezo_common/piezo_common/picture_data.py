# SPDX-License-Identifier: BSD-3-Clause
"""The numbers behind a picture: curves, areas and maps of a matplotlib figure, and their CSV."""

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from piezo_common.arrays import FloatArray
from piezo_common.picture_style import thinned

DIGITS = "{:.6g}"

MOST_CELLS = 20_000
"""Maximum number of cells of a map; of a larger one, every n-th row and column is kept."""


@dataclass(frozen=True, eq=False)
class Numbers:
    """The numbers of one line, area or map of a picture."""

    name: str
    """Label in the legend; empty without one."""
    columns: dict[str, FloatArray]
    """Values by the labels of the axes, with their units."""


@dataclass(frozen=True, eq=False)
class PictureTable:
    """The numbers that a figure shows, a column for each curve.

    A column of positions applies to the curves after it, up to the next such column. Lines across
    the whole picture, such as limits, are omitted, as legend or text gives their values.
    """

    heads: list[str]
    columns: list[FloatArray]

    def csv(self) -> str:
        """Return the table as CSV; shorter columns end in empty fields, no column gives no text."""
        if not self.columns:
            return ""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        # The script of a page takes each line after the first as numbers.
        writer.writerow([" ".join(head.split()) for head in self.heads])
        writer.writerows(zip_longest(*([DIGITS.format(value) for value in column]
                                       for column in self.columns), fillvalue=""))
        return stream.getvalue()


def picture_table(figure: Figure) -> PictureTable:
    """Return the numbers that a figure shows."""
    heads: list[str] = []
    columns: list[FloatArray] = []
    for axes in panels(figure):
        for shown in numbers_of(axes):
            (x_label, x), *others = shown.columns.items()
            # Curves with the same positions share one column of them.
            if not any(head == x_label and np.array_equal(x, column)
                       for head, column in zip(heads, columns, strict=True)):
                others = [(x_label, x), *others]
            for label, values in others:
                heads.append(label if label == x_label or not shown.name
                             else f"{shown.name}: {label}")
                columns.append(values)
    return PictureTable(heads, columns)


def panels(figure: Figure) -> list[Axes]:
    """Return the axes of a figure without those of its colour bars."""
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]


def numbers_of(axes: Axes) -> Iterator[Numbers]:
    """Yield the numbers of the lines, the areas and the maps of axes."""
    x_label, y_label = axis_label(axes, "x"), axis_label(axes, "y")
    for line in axes.get_lines():
        if line.get_transform() == axes.transData:
            x, y = curve_of(line)
            yield Numbers(legend_name(line), {x_label: x, y_label: y})
    for area in axes.collections:
        if isinstance(area, QuadMesh):
            values: Any = np.ma.asarray(area.get_array())
            corners = np.asarray(area.get_coordinates(), dtype=float)
            centres = 0.25 * (corners[1:, 1:] + corners[1:, :-1] + corners[:-1, 1:]
                              + corners[:-1, :-1])
            shown = ~np.ma.getmaskarray(values).reshape(centres.shape[:2])
            every = slice(None, None, int(np.ceil(np.sqrt(shown.sum() / MOST_CELLS))) or 1)
            kept = np.zeros_like(shown)
            kept[every, every] = True
            shown &= kept
            bar = area.colorbar.ax.get_ylabel() if area.colorbar else "value"
            yield Numbers("", {x_label: centres[..., 0][shown], y_label: centres[..., 1][shown],
                               bar: np.ma.getdata(values).reshape(shown.shape)[shown]})
        elif isinstance(area, PolyCollection) and area.get_paths():
            outline = np.concatenate([path.vertices for path in area.get_paths()])
            yield Numbers(f"{legend_name(area) or 'area'}, outline",
                          {x_label: outline[:, 0], y_label: outline[:, 1]})


def curve_of(line: Line2D) -> tuple[FloatArray, FloatArray]:
    """Return the points of a line, thinned to as many as are distinguishable."""
    x, y = (np.asarray(values, float) for values in line.get_data(orig=False))
    return thinned(x, y)


def legend_name(artist: object) -> str:
    """Return the label of a line or area; empty if it is not in the legend."""
    text = str(artist.get_label())  # type: ignore[attr-defined]
    return "" if text.startswith("_") else text


def axis_label(axes: Axes, direction: str) -> str:
    """Return the label of the axis "x" or "y", or that of an adjacent one that shares its scale."""
    shared = getattr(axes, f"get_shared_{direction}_axes")().get_siblings(axes)
    texts = [str(getattr(one, f"get_{direction}label")()) for one in (axes, *reversed(shared))]
    return next(filter(None, texts), direction)
