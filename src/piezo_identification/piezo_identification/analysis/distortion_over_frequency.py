# SPDX-License-Identifier: BSD-3-Clause
"""Noise, even and odd distortion over frequency, as a figure and as a table of bands."""

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes

from piezo_common.picture_style import (
    BLUE,
    GREEN,
    GREY,
    VERMILION,
    WIDE_IN,
    label,
    new_figure,
    plain_numbers,
    to_png,
)
from piezo_identification.analysis.nonlinear_distortion import NonlinearDistortion

MOST_BANDS = 6
"""Most bands of a table, so that it fits on the screen of a phone."""

FEWEST_LEFT_OUT = 3
"""Fewest omitted odd lines in a band, so that the mean odd distortion can be computed."""


def distortion_bands(found: NonlinearDistortion) -> list[NonlinearDistortion]:
    """Divide all lines of a distortion into bands of about equal logarithmic width."""
    count = found.frequency_hz.size
    edges_hz = np.geomspace(found.frequency_hz[0], found.frequency_hz[-1], MOST_BANDS + 1)
    bands, begin = [], 0
    for end in (*np.searchsorted(found.frequency_hz, edges_hz[1:-1]), count):
        enough = [np.count_nonzero(found.is_odd_detection[part]) >= FEWEST_LEFT_OUT
                  for part in (slice(begin, end), slice(end, None))]
        if end == count or all(enough):
            bands.append(_part(found, slice(begin, end)))
            begin = end
    return bands


def distortion_rows(found: NonlinearDistortion) -> list[tuple[str, ...]]:
    """Return the table over frequency: its heads, then a row for each band and one for all.

    Values are RMS in nm; insignificant distortion is given as an upper bound.
    """
    heads = ("frequency (Hz)", "answer (nm)", "noise of a period (nm)", "even (nm)", "odd (nm)")
    bands = distortion_bands(found)
    return [heads, *(_row(band, f"{band.frequency_hz[0]:.4g} to {band.frequency_hz[-1]:.4g}")
                     for band in bands), _row(found, "all")]


def draw_distortion(axes: Axes, found: NonlinearDistortion) -> None:
    """Draw response, noise, even and odd distortion over the lines."""
    noise_nm = 1e3 * found.noise_um / np.sqrt(found.periods)
    axes.loglog(found.frequency_hz, noise_nm, color=GREY, linewidth=1.0, zorder=1,
                label=f"noise of the mean of {found.periods} periods")
    for lines, color, marker, text in (
            (found.is_excited, BLUE, ".", "answer, at odd lines that are excited"),
            (found.is_even, VERMILION, "x", "even distortion, at even lines"),
            (found.is_odd_detection, GREEN, "^", "odd distortion, at odd lines not excited")):
        axes.loglog(found.frequency_hz[lines], 1e3 * found.amplitude_um[lines], color=color,
                    marker=marker, markersize=3.0, linestyle="none", label=text)
    label(axes, "frequency (Hz)", "amplitude (nm)")
    plain_numbers(axes.xaxis)
    axes.legend(loc="lower left", fontsize="small")


def distortion_png(found: NonlinearDistortion) -> bytes:
    """Return the picture of `draw_distortion` as the bytes of a PNG file."""
    figure = new_figure(4.2, WIDE_IN)
    draw_distortion(figure.subplots(), found)
    return to_png(figure, 110)


def _part(found: NonlinearDistortion, lines: slice) -> NonlinearDistortion:
    return replace(found, **{
        name: getattr(found, name)[lines]
        for name in ("frequency_hz", "is_excited", "is_even", "amplitude_um", "noise_um")})


def _row(found: NonlinearDistortion, band: str) -> tuple[str, ...]:
    parts = [
        f"{1e3 * part_um:.3g}" if part_um > found.significant_um
        else f"below {1e3 * found.significant_um:.2g}" for part_um in (found.even_um, found.odd_um)]
    return (band, f"{1e3 * found.answer_um:.4g}", f"{1e3 * found.noise_of_period_um:.3g}", *parts)
