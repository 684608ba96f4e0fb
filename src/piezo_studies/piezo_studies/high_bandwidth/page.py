# SPDX-License-Identifier: BSD-3-Clause
"""The page and the picture of the study."""

import numpy as np

from piezo_common.picture_style import CURVES, LIMIT, label, new_figure
from piezo_controller.feedback.sample_rate.fast_design import Demands
from piezo_studies.high_bandwidth.trade_off import LIGHT_MODE_ERRORS, PEAKS, TITLES

HEADER = ("method", "light mode off by", "worst peak", "margin", "bandwidth", "lowest bandwidth",
          "at 50 Hz", "at 100 Hz", "added noise", "noise of the voltage", "order")

INTRODUCTION = """\
# Feedback beyond the first mode

Written by `make high-bandwidth`; do not edit.

A law that runs at the sample clock (40 kHz) can have a bandwidth beyond the first mode of the
stage. The function `piezo_controller.feedback.sample_rate.fast_design.design_at_sample_rate` takes
an identified model and returns a controller at the clock's period. `save_controller` writes it to
a [controller file](files.md#controller). This page compares its methods on the identified model of
the simulated stage, whose dynamics are those that the thesis identified.

**The loop.** The displacement of a sample is answered two samples later, which is the convention
of the suite with one sample a tick. The modes lie at {modes_hz}.

**The demands.** The closed loop falls to -3 dB at no less than {ratio:g} times the first mode
({bandwidth_hz:.0f} Hz). A disturbance of the displacement is attenuated by {attenuation}. Of what
is reached above these, the least is the *margin*.

**The bounds, equal for all methods.** The loop is stable, and its sensitivity stays below the peak
of the row, for every stage of a set: both ends of the gain of the hysteresis, every parameter off
by {parameter:.0f} %, and the light mode off by the error of the row. The noise of the sensor is
{noise_nm:.0f} nm. The thesis calls it white and samples at 40 kHz (section 1.2), and the simulator
draws it for every sample of the 40 kHz clock: it is white up to 20 kHz, {density:.3f} nm per root
Hz. It may add {added_nm:.0f} nm to the displacement and {voltage:g} V to the voltage, both root
mean square.

**The search.** Every method is a family of few numbers, and each family is searched in the same
way: for the largest margin within the bounds. The H-infinity family has the weights of a
four-block problem and constant scalings D of two uncertainties, the gain and the square of the
light mode's frequency. A row in brackets exceeds a bound, because the search found nothing within
them.

The H-infinity family is tried least often, because each try is a synthesis, and its search has not
converged: at 10 % it ends beyond a bound that it keeps at 20 %. Its rows are what the search found,
not the best that the method can give.

![Margin to the demands against the error of the light mode](pictures/high_bandwidth.png)

Where a line lies above zero, all demands are met. A point is left out where the search found
nothing within the bounds.
"""


def draw(compared):
    """Return the figure of the margins over the light mode's error."""
    figure = new_figure()
    for axes, peak in zip(figure.subplots(1, len(PEAKS), sharey=True, squeeze=False)[0],
                          PEAKS, strict=True):
        for (method, title), style in zip(TITLES.items(), CURVES, strict=False):
            margins = [next((row.controller.report["margin_db"] for row in compared
                             if (row.method, row.light_mode_error, row.worst_peak)
                             == (method, error, peak) and row.keeps_bounds), np.nan)
                       for error in LIGHT_MODE_ERRORS]
            axes.plot(100 * np.array(LIGHT_MODE_ERRORS), margins, marker="o", label=title, **style)
        axes.axhline(0.0, **LIMIT)
        label(axes, "error of the light mode (%)",
              "margin to the demands (dB)" if peak == PEAKS[0] else None,
              f"worst peak sensitivity {peak:g}")
    axes.legend(fontsize="x-small")
    return figure


def _row(row):
    cells = [TITLES[row.method], f"{100 * row.light_mode_error:.0f} %"]
    if row.controller is None:
        return [*cells, "not stable", *[""] * (len(HEADER) - 3)]
    report, figures = row.controller.report, row.controller.report["figures"]
    at_50, at_100 = figures["attenuation_db"]
    cells += [f"{figures['worst_peak_sensitivity']:.2f}", f"{report['margin_db']:+.1f} dB",
              f"{figures['bandwidth_hz']:.0f} Hz", f"{figures['worst_bandwidth_hz']:.0f} Hz",
              f"{at_50:.1f} dB", f"{at_100:.1f} dB", f"{1e3 * report['added_noise_um']:.1f} nm",
              f"{report['noise_voltage_v']:.2f} V", str(report["order"])]
    return cells if row.keeps_bounds else [cells[0], *(f"({cell})" for cell in cells[1:])]


def page(model, compared):
    """Return the page as Markdown."""
    demands = Demands()
    modes_hz = np.array(model.dynamics.mode_frequencies_rad_per_s) / (2 * np.pi)
    parts = [INTRODUCTION.format(
        modes_hz=" and ".join(f"{mode_hz:.0f} Hz (damping ratio {damping:.2f})" for mode_hz, damping
                              in zip(modes_hz, model.dynamics.damping_ratios, strict=True)),
        ratio=demands.bandwidth_ratio, bandwidth_hz=demands.bandwidth_ratio * modes_hz.min(),
        attenuation=" and ".join(f"{db:g} dB at {hz:g} Hz" for hz, db in zip(
            demands.disturbance_hz, demands.attenuation_db, strict=True)),
        parameter=100 * demands.errors.parameter, noise_nm=1e3 * demands.sensor_noise_um,
        density=1e3 * demands.sensor_noise_um / np.sqrt(20e3),
        added_nm=1e3 * demands.added_noise_um, voltage=demands.noise_voltage_v)]
    for peak in PEAKS:
        rows = [HEADER, ["---"] * len(HEADER),
                *(_row(row) for row in compared if row.worst_peak == peak)]
        parts.append(f"## Worst peak sensitivity {peak:g}\n\n"
                     + "\n".join("| " + " | ".join(cells) + " |" for cells in rows) + "\n")
    return "\n".join(parts)
