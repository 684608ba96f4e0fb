# SPDX-License-Identifier: BSD-3-Clause
"""Common style of all pictures: size, labels, PNG, and lines that differ without colour.

The colours are of Okabe and Ito's palette. Two lines of one picture differ in dashes or marker, or
in lightness so much that they also differ in grey. Lightness is used for signals that are too dense
for dashes.
"""

import io
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from PIL import Image

from piezo_common.arrays import FloatArray

WIDTH_IN, WIDE_IN = 5.6, 8.0
DOTS_PER_INCH = 180
SHOWN_DOTS_PER_INCH = 100
MOST_POINTS = 2400
"""Points of a line; of a longer one, the minimum and maximum of each stretch are drawn."""

BAND = 2.0
"""Half width of a band in standard deviations; it contains 95 % of normal errors."""

# From dark to light, with the lightness L* of CIELAB; grey is not of the palette.
BLACK, BLUE, VERMILION, GREEN = "#000000", "#0072b2", "#d55e00", "#009e73"  # 0, 46, 55, 58
PURPLE, ORANGE, GREY = "#cc79a7", "#e69f00", "#b3b3b3"  # 61, 71, 73

BEFORE: dict[str, Any] = {"color": ORANGE, "linestyle": "-", "linewidth": 1.6, "label": "before"}
AFTER: dict[str, Any] = {"color": BLUE, "linestyle": "-", "linewidth": 0.9, "label": "after"}
MEASURED: dict[str, Any] = {"color": GREY, "linewidth": 3.0, "label": "measured"}
MODELLED: dict[str, Any] = {"color": BLUE, "linewidth": 1.2, "label": "modelled"}
DIFFERENCE: dict[str, Any] = {
    "color": VERMILION, "linestyle": "none", "marker": ".", "markersize": 1.5}
REFERENCE: dict[str, Any] = {"color": GREY, "linewidth": 4.0, "label": "reference"}
FEEDFORWARD = {"color": ORANGE, "linewidth": 1.6, "label": "feedforward"}
FEEDBACK = {"color": BLUE, "linewidth": 0.8, "label": "feedback"}
LIMIT: dict[str, Any] = {"color": BLACK, "linestyle": ":", "linewidth": 1.0}
MODE_STYLES = {
    "open_loop": {"color": ORANGE, "linestyle": ":", "linewidth": 2.2, "label": "open loop"},
    "feedforward": {"color": VERMILION, "linestyle": "--", "linewidth": 1.6,
                    "label": "feedforward"},
    "composite": {"color": BLUE, "linestyle": "-", "linewidth": 1.3, "label": "composite"},
}
PID = {"color": GREEN, "linestyle": "-.", "linewidth": 1.4, "label": "PID"}
CURVES: tuple[dict[str, Any], ...] = tuple(
    {"color": color, "linestyle": linestyle, "linewidth": 1.5} for color, linestyle in (
        (BLUE, "-"), (ORANGE, "--"), (GREEN, "-."), (VERMILION, ":"), (PURPLE, (0, (6, 1.5))),
        (BLACK, (0, (6, 1.5, 1, 1.5, 1, 1.5)))))
"""Styles for smooth curves of equal importance."""


class ShownFigure(Figure):
    """A figure that a notebook displays although it does not belong to pyplot."""

    def _repr_png_(self) -> bytes:
        return to_png(self, SHOWN_DOTS_PER_INCH)


def new_figure(height_in: float = 3.8, width_in: float = WIDTH_IN) -> Figure:
    """Return a figure that is independent of pyplot's global state and of any display."""
    figure = ShownFigure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def label(axes: Axes, x: str | None = None, y: str | None = None,
          title: str | None = None) -> None:
    """Label axes, and draw a light grid behind the lines."""
    texts: dict[str, Any] = {"xlabel": x, "ylabel": y, "title": title}
    axes.set(**{key: text for key, text in texts.items() if text})
    axes.title.set_fontsize("medium")
    axes.grid(True, color="0.88", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in "top", "right":
        axes.spines[side].set_visible(False)


def plain_numbers(axis: Axis) -> None:
    """Write the numbers of a logarithmic axis as 0.1, 1, 10."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def outline(x: FloatArray, y: FloatArray,
            most: int = MOST_POINTS) -> tuple[FloatArray, FloatArray]:
    """Return a line of few points that looks like the whole: its envelope where it is dense.

    The points, (N,), are in the order of x. If there are more than `most`, the result has minimum
    and maximum of y of each stretch, at its first x.
    """
    if x.size <= most:
        return x, y
    stretch = -(-2 * x.size // most)
    count = x.size // stretch
    parts = y[: count * stretch].reshape(count, stretch)
    both = np.column_stack([parts.min(axis=1), parts.max(axis=1)]).ravel()
    return np.repeat(x[: count * stretch : stretch], 2), both


def thinned(x: FloatArray, y: FloatArray,
            most: int = MOST_POINTS) -> tuple[FloatArray, FloatArray]:
    """Return few points of a curve, (N,): its `outline` for rising x, else every n-th point."""
    if x.size <= most:
        return x, y
    if np.all(np.diff(x) >= 0.0):
        return outline(x, y, most)
    every = slice(None, None, -(-x.size // most))
    return x[every], y[every]


def to_png(figure: Figure, dots_per_inch: float = DOTS_PER_INCH,
           colours: int | None = None) -> bytes:
    """Return a figure as the bytes of a PNG file.

    A number of colours of a palette reduces the file to a third; by default it has all.
    """
    stream = io.BytesIO()
    # Pillow's search for the smallest file takes as long as the drawing, and saves 5 %.
    figure.savefig(stream, format="png", dpi=dots_per_inch)
    if colours is None:
        return stream.getvalue()
    small = io.BytesIO()
    with Image.open(stream) as picture:
        picture.convert("RGB").quantize(colours, Image.Quantize.FASTOCTREE).save(small, "png")
    return small.getvalue()
