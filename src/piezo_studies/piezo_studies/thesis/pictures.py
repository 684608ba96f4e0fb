# SPDX-License-Identifier: BSD-3-Clause
"""Common functions for the figures of the studies."""

import io

import numpy as np

from piezo_common.picture_style import BLUE, LIMIT, label, new_figure

DOTS_PER_INCH = 85


def draw_plane(figure, axes, levels_v, values, unit):
    """Draw values, (L, L), over the Preisach plane with edges at L + 1 levels.

    Only values on and below the diagonal are drawn, and no nan. The colour bar has the given unit.
    """
    hidden = np.triu(np.ones(values.shape, dtype=bool), 1) | np.isnan(values)
    shown = np.ma.array(values, mask=hidden)
    image = axes.pcolormesh(levels_v, levels_v, shown, cmap="cividis")
    figure.colorbar(image, ax=axes, label=unit)
    axes.set_aspect("equal")
    axes.locator_params(nbins=5, steps=[1, 2, 5, 10], integer=True)
    label(axes, "switches off at (V)", "switches on at (V)")
    axes.grid(False)


def draw_estimate(estimate, threshold):
    """Draw the singular values of an estimate with the truncation threshold, and its density."""
    figure = new_figure(2.6)
    left, right = figure.subplots(1, 2)
    _draw_singular_values(left, estimate.singular_values, threshold)
    draw_plane(figure, right, estimate.levels_v, estimate.density_um_per_v2, "density (um/V²)")
    return figure


def _draw_singular_values(axes, values, threshold):
    shown = values[values > 1e-9 * values[0]]
    axes.semilogy(np.arange(1, shown.size + 1), shown, color=BLUE)
    axes.axhline(threshold, label="truncated below", **LIMIT)
    axes.legend()
    label(axes, "number", "singular value (1)")


def small_png(figure):
    """Return a figure as the bytes of a small PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DOTS_PER_INCH, pil_kwargs={"optimize": True})
    return stream.getvalue()
