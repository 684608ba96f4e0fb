# SPDX-License-Identifier: BSD-3-Clause
"""The curves of a matplotlib figure in a browser, with zoom, hover and a legend that hides curves.

Bokeh draws them. Its script is part of its wheel, so that a page needs no network. Compressed it is
a third of 1.2 MB, and the browser unpacks it at the first use. Plotly's is 4.6 MB, as no wheel
contains its smaller bundles. Without Bokeh the pages contain only static pictures.

A page contains the numbers of a curve once: the item refers to the columns of the picture's table.
"""

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from piezo_common.arrays import FloatArray
from piezo_common.picture_data import axis_label, curve_of, legend_name, panels

PIXELS_PER_INCH = 96
DASHES = {"-": "solid", "--": "dashed", ":": "dotted", "-.": "dashdot"}
SHOWN_COLORS = 256

SCRIPT = """
<script type="application/gzip" id="bokeh">{bokeh}</script>
<script>
async function unpacked(text) {{
  const packed = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).text();
}}
for (const closer of document.querySelectorAll("details.closer"))
  closer.addEventListener("toggle", async () => {{
    const [place, item] = [closer.querySelector("div"), closer.querySelector("script")];
    if (!closer.open || !item) return;
    item.remove();
    window.Bokeh || (0, eval)(await unpacked(document.querySelector("#bokeh").textContent));
    place.id = "closer-" + Math.random().toString(36).slice(2);
    const table = closer.parentElement.querySelector("a[download]");
    const lines = table ? (await unpacked(table.href.split(",")[1])).trim().split("\\n") : [];
    const rows = lines.slice(1).map(line => line.split(","));
    const column = index => rows.map(row => row[index]).filter(text => text).map(Number);
    Bokeh.embed.embed_item(JSON.parse(await unpacked(item.textContent), (_, value) =>
      value?.type === "column" ? column(value.index) : value), place.id);
  }});
</script>
"""


def is_available() -> bool:
    """Return True if Bokeh is installed."""
    return find_spec("bokeh") is not None


def interactive_script() -> str:
    """Return the script elements that draw a page's items; only these contain Bokeh's code."""
    from bokeh.resources import INLINE

    (bokeh,) = (text for text in INLINE.js_raw[:1])
    return SCRIPT.format(bokeh=packed(bokeh))


def packed(text: str) -> str:
    """Return a text in the form that the page's script unpacks: gzip, in base64."""
    # No time stamp, so that the same text gives the same page.
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def interactive_item(figure: Figure, columns: Sequence[FloatArray]) -> dict[str, Any] | None:
    """Return the lines, areas and maps of a figure as an item that Bokeh embeds.

    Panels are placed as in the figure; those that share an axis zoom together. Where the item has
    the same numbers as a column of the picture's table, it has ``{"type": "column", "index":
    ...}``, which the page's script replaces. It is None without Bokeh, or for a figure without
    lines, areas and maps.
    """
    if not is_available():
        return None
    from bokeh.embed import json_item
    from bokeh.layouts import column, row

    plots: dict[Axes, Any] = {}
    for axes in panels(figure):
        plot = _plot(figure, axes, plots)
        # Bars and pixel images have no curves to enlarge.
        if plot.renderers:
            plots[axes] = plot
    if not plots:
        return None
    rows: dict[int, list[Any]] = {}
    for axes, plot in plots.items():
        place = axes.get_subplotspec()
        rows.setdefault(0 if place is None else place.rowspan.start, []).append(plot)
    whole = column([row(each, sizing_mode="stretch_width") for each in rows.values()],
                   sizing_mode="stretch_width")
    # Only plain numbers and texts; checked here, not in the reader's browser.
    return json.loads(json.dumps(json_item(whole)), object_hook=partial(
        _column_or_same, {column.tobytes(): index for index, column in enumerate(columns)}))


def _column_or_same(index_of: Mapping[bytes, int], part: dict[str, Any]) -> dict[str, Any]:
    """Return the reference to a column in place of an array of the same numbers."""
    if part.get("type") != "ndarray":
        return part
    numbers = gzip.decompress(base64.b64decode(part["array"]["data"]))
    return {"type": "column", "index": index_of[numbers]} if numbers in index_of else part


def _plot(figure: Figure, axes: Axes, earlier: Mapping[Axes, Any]) -> Any:
    from bokeh.models import BoxZoomTool, HoverTool
    from bokeh.plotting import figure as new_plot

    shared: dict[str, Any] = {}
    for direction in "x", "y":
        siblings = getattr(axes, f"get_shared_{direction}_axes")().get_siblings(axes)
        of_sibling = next((earlier[one] for one in siblings if one in earlier), None)
        shared[f"{direction}_range"] = (
            getattr(of_sibling, f"{direction}_range") if of_sibling is not None
            else getattr(axes, f"get_{direction}lim")())
    height = axes.get_position().height * figure.get_figheight() * PIXELS_PER_INCH
    plot = new_plot(
        x_axis_type=_scale(axes.get_xscale()), y_axis_type=_scale(axes.get_yscale()),
        x_axis_label=_plain(axis_label(axes, "x")), y_axis_label=_plain(axis_label(axes, "y")),
        title=_plain(axes.get_title()), height=max(220, round(height)),
        match_aspect=axes.get_aspect() == 1.0, output_backend="canvas",
        sizing_mode="stretch_width", tools="pan,wheel_zoom,reset,save", **shared)
    plot.toolbar.logo = None
    box = BoxZoomTool()
    plot.add_tools(box, HoverTool(tooltips=[("x", "$x{0.[00000]}"), ("y", "$y{0.[00000]}")]))
    plot.toolbar.active_drag = box
    for area in axes.collections:
        _add_area(plot, area)
    for line in axes.get_lines():
        _add_line(plot, axes, line)
    if plot.legend:
        legend = plot.legend[0]
        legend.update(click_policy="hide", label_text_font_size="9pt", orientation="horizontal")
        # The legend is outside the curves.
        plot.add_layout(legend, "above")
    return plot


def _add_line(plot: Any, axes: Axes, line: Line2D) -> None:
    from bokeh.models import Span

    style = {"line_color": to_hex(line.get_color()), "line_width": line.get_linewidth(),
             "line_dash": DASHES.get(str(line.get_linestyle()), "dashed")}
    x, y = curve_of(line)
    if line.get_transform() == axes.get_yaxis_transform():
        plot.add_layout(Span(location=float(y[0]), dimension="width", **style))
    elif line.get_transform() == axes.get_xaxis_transform():
        plot.add_layout(Span(location=float(x[0]), dimension="height", **style))
    elif line.get_transform() == axes.transData:
        text = _plain(legend_name(line))
        named = {"legend_label": text} if text else {}
        if line.get_linestyle() not in ("None", "none", "", " "):
            plot.line(x, y, **style, **named)
        if line.get_marker() not in ("None", "none", "", None):
            plot.scatter(x, y, size=max(3.0, line.get_markersize()), color=style["line_color"],
                         **named)


def _add_area(plot: Any, area: Any) -> None:
    if isinstance(area, QuadMesh):
        _add_map(plot, area)
    elif isinstance(area, PolyCollection):
        text = _plain(legend_name(area))
        named = {"legend_label": text} if text else {}
        colors = np.asarray(area.get_facecolor(), dtype=float).reshape(-1, 4)
        red, green, blue, alpha = colors[0] if colors.size else (0.5, 0.5, 0.5, 0.2)
        for path in area.get_paths():
            outline = np.asarray(path.vertices, dtype=float)
            plot.patch(outline[:, 0], outline[:, 1], fill_color=to_hex((red, green, blue)),
                       fill_alpha=float(alpha), line_alpha=0.0, **named)


def _add_map(plot: Any, mesh: QuadMesh) -> None:
    from bokeh.models import LinearColorMapper

    low, high = mesh.get_clim()
    corners = np.asarray(mesh.get_coordinates(), dtype=float)
    (left, bottom), (right, top) = corners[0, 0], corners[-1, -1]
    values: Any = np.ma.asarray(mesh.get_array()).reshape(corners.shape[0] - 1, -1)
    # One byte for the colour of a cell; the last one is for cells without a value.
    none = SHOWN_COLORS - 1
    palette = [*(to_hex(color) for color in mesh.cmap(np.linspace(0.0, 1.0, none))), "#ffffff"]
    color = np.clip(np.rint((values - low) / (high - low) * (none - 1)), 0, none - 1)
    plot.image([np.ma.filled(color, none).astype(np.uint8)], x=left, y=bottom,
               dw=right - left, dh=top - bottom,
               color_mapper=LinearColorMapper(palette=palette, low=0, high=none))


def _scale(name: str) -> str:
    return "log" if name == "log" else "linear"


def _plain(text: str) -> str:
    """Return a label without math markup, for which Bokeh would load a library."""
    return text.replace("$", "").replace("\\", "").replace("_", " ")
