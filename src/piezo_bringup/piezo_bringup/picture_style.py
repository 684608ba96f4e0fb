# SPDX-License-Identifier: BSD-3-Clause
"""What the report's pictures share: size, colours that survive colour blindness and grey, PNG."""

import io

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

WIDTH_IN = 5.6
DOTS_PER_INCH = 180

# Of Okabe and Ito's palette; each goes with a line style of its own.
BLACK, GREY, BLUE, VERMILION = "#000000", "#8c8c8c", "#0072b2", "#d55e00"
ORANGE, GREEN = "#e69f00", "#009e73"
BEFORE = {"color": VERMILION, "linestyle": "--", "linewidth": 1.1, "label": "before"}
AFTER = {"color": GREEN, "linestyle": "-", "linewidth": 1.1, "label": "after"}
MEASURED = {"color": GREY, "linewidth": 3.0, "label": "measured"}
MODELLED = {"color": BLUE, "linewidth": 1.2, "label": "modelled"}
DIFFERENCE = {"color": VERMILION, "linestyle": "none", "marker": ".", "markersize": 1.5}
MODE_STYLES = {
    "open_loop": {"color": ORANGE, "linestyle": ":", "linewidth": 2.2, "label": "open loop"},
    "feedforward": {"color": VERMILION, "linestyle": "--", "linewidth": 1.6,
                    "label": "feedforward"},
    "composite": {"color": BLUE, "linestyle": "-", "linewidth": 1.3, "label": "composite"},
}
PID = {"color": GREEN, "linestyle": "-.", "linewidth": 1.4, "label": "PID"}
REFERENCE = {"color": GREY, "linewidth": 4.0, "label": "reference"}


def new_figure(height_in=3.8):
    """A figure of its own, apart from pyplot's global state and any display."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def label(axes, x=None, y=None, title=None):
    """Label axes, with a light grid behind the lines."""
    axes.set(**{key: text for key, text in (("xlabel", x), ("ylabel", y), ("title", title))
                if text})
    axes.title.set_size("medium")
    axes.grid(True, color="0.88", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in "top", "right":
        axes.spines[side].set_visible(False)


def plain_numbers(axis):
    """Write the numbers of a logarithmic axis as 0.1, 1, 10."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def to_png(figure):
    """Return a figure as the bytes of a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DOTS_PER_INCH)
    return stream.getvalue()
