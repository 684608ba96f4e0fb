# SPDX-License-Identifier: BSD-3-Clause
"""The page and the figure of the study."""

from itertools import cycle

import numpy as np

from piezo_common.picture_style import CURVES, LIMIT, label, new_figure
from piezo_controller.feedback.sample_rate.demands import Demands
from piezo_controller.feedback.sample_rate.perturbed_loops import light_mode
from piezo_studies.high_bandwidth.trade_off import DEMANDS, LIGHT_MODE_ERRORS, TITLES

TABLES = ((False, "The model itself"), (True, "Every stage"))

HEADER = ("method", "light mode off by", "worst peak", "margin", "bandwidth", "lowest bandwidth",
          "at 50 Hz", "least", "at 100 Hz", "least", "added noise", "noise of the voltage", "order")

INTRODUCTION = """\
# Feedback beyond the first mode

Written by `make high-bandwidth`; do not edit.

A law that runs at the sample clock (40 kHz) can have a bandwidth beyond the first mode of the
stage. The function `piezo_controller.feedback.sample_rate.fast_design.design_at_sample_rate` takes
an identified model and returns a controller at the clock's period. `save_controller` writes it to
a [controller file](files.md#controller). This page compares its methods on the identified model of
the simulated stage, whose dynamics are those that the thesis identified.

**The loop.** The stage evaluates the law by itself: the displacement of a sample is answered by
the next one, and `track` uploads such a controller file as it does one of the tick's rate. The
modes lie at {modes_hz}.

**The demands.** The closed loop falls to -3 dB at no less than {ratio:g} times the first mode
({bandwidth_hz:.0f} Hz). A disturbance of the displacement is attenuated by {attenuation}, wherever
its frequency lies within {tolerance:g} % of that. Of what is reached above these, the least is the
*margin*: in the first table that of the model itself, in the second the least of all stages.

**The bounds, equal for all methods.** The loop is stable, and its sensitivity stays below {peak:g},
for every stage of a set: both ends of the gain of the hysteresis, every parameter off
by {parameter:.0f} %, and the light mode off by the error of the row. The noise of the sensor is
{noise_nm:.0f} nm. The thesis calls it white and samples at 40 kHz (section 1.2), and the simulator
draws it for every sample of the 40 kHz clock: it is white up to 20 kHz, {density:.3f} nm per root
Hz. It may add {added_nm:.0f} nm to the displacement and {voltage:g} V to the voltage, both root
mean square. By default `design_at_sample_rate` allows {default_voltage:g} V, as more looks like an
oscillation to the guards of the stage, and no stage of the set may amplify an error that is slower
than half the lowest disturbance.

**The methods.** A controller of *fixed order* is an integration with seven pairs of poles and six
pairs of zeros, and some real ones. It is tuned over all stages at once by sequential linear
programming, with the derivatives of every loop at every frequency, and begins anew many times.
`piezo_studies.high_bandwidth.search` searches for where to begin, see below. The tuning ends at a
margin of 3 dB, which is how far the closed loop falls at the edge of its band. Its *resonances*
attenuate the disturbances in a narrow band, and spend no gain beside it: between the lines it
attenuates as little as a slow loop does. It is the method of `design_at_sample_rate`. The other
methods have few numbers, are searched by trial, and are there to be compared
(`piezo_controller.feedback.sample_rate.searched_designs`). H-infinity has the weights of a
four-block problem and constant scalings D of two uncertainties, the gain and the square of the
light mode's frequency, which it takes for complex. Its rows are what the search found, not the best
that the method can give. A row in brackets exceeds a bound, because the search found nothing within
them.

![Margin to the demands against the error of the light mode](pictures/high_bandwidth.png)

Where a line lies above zero, all demands are met. A point is left out where the search found
nothing within the bounds.

**Why the light mode limits the loop.** Below and above its resonance a mode differs by 180 degrees.
Off by 20 % it lies anywhere from {low_hz:.0f} Hz to {high_hz:.0f} Hz. In this band the phase of the
loop is unknown by 180 degrees, and its gain by the {peak_db:.0f} dB of the resonance.
"""


SEARCHES = """\
## From drawn starts

`python -m piezo_studies.high_bandwidth.search` draws the numbers of a controller of fixed order by
a seed, tunes them over ever larger errors of the light mode, and changes the best at random.
A search proves no bound: what it did not find may exist.
"""

SEARCH_HEADER = "light mode off by", "to reach the demands", "seed", "starts, trials", "margin"


def searched_table(searches):
    """Return the rows of the table of search results."""
    rows = []
    for found in searches:
        demands = found["demands"]
        rows.append((
            f"{100 * demands['errors']['light_mode']:.0f} %",
            "every stage" if demands["of_every_stage"] else "the model",
            str(found["seed"]), f"{found['starts']}, {found['trials']}",
            f"{found['margin_db']:+.1f} dB"))
    return [SEARCH_HEADER, ["---"] * len(SEARCH_HEADER), *sorted(rows)]


def draw(compared):
    """Return the figure of the margins over the light mode's error."""
    figure = new_figure()
    axes = figure.subplots()
    for (method, name), style in zip(TITLES.items(), cycle(CURVES), strict=False):
        margins = [next((row.controller.report["margin_db"] for row in compared
                         if (row.method, row.light_mode_error, row.of_every_stage)
                         == (method, error, False) and row.keeps_bounds), np.nan)
                   for error in LIGHT_MODE_ERRORS]
        axes.plot(100 * np.array(LIGHT_MODE_ERRORS), margins, marker="o", label=name, **style)
    axes.axhline(0.0, **LIMIT)
    label(axes, "error of the light mode (%)", "margin to the demands (dB)")
    axes.legend(fontsize="x-small")
    return figure


def _row(row):
    cells = [TITLES[row.method], f"{100 * row.light_mode_error:.0f} %"]
    if row.controller is None:
        return [*cells, "not stable", *[""] * (len(HEADER) - 3)]
    report, figures = row.controller.report, row.controller.report["figures"]
    attenuation = [f"{db:.1f} dB" for both in zip(
        figures["attenuation_db"], figures["worst_attenuation_db"], strict=True) for db in both]
    cells += [f"{figures['worst_peak_sensitivity']:.2f}", f"{report['margin_db']:+.1f} dB",
              f"{figures['bandwidth_hz']:.0f} Hz", f"{figures['worst_bandwidth_hz']:.0f} Hz",
              *attenuation, f"{1e3 * report['added_noise_um']:.1f} nm",
              f"{report['noise_voltage_v']:.2f} V", str(report["order"])]
    return cells if row.keeps_bounds else [cells[0], *(f"({cell})" for cell in cells[1:])]


def page(model, compared, searches=()):
    """Return the page on designs and search results as Markdown."""
    demands = DEMANDS
    modes_hz = np.array(model.dynamics.mode_frequencies_rad_per_s) / (2 * np.pi)
    light_hz = modes_hz[light_mode(model)]
    parts = [INTRODUCTION.format(
        modes_hz=" and ".join(f"{mode_hz:.0f} Hz (damping ratio {damping:.2f})" for mode_hz, damping
                              in zip(modes_hz, model.dynamics.damping_ratios, strict=True)),
        ratio=demands.bandwidth_ratio, bandwidth_hz=demands.bandwidth_ratio * modes_hz.min(),
        attenuation=" and ".join(f"{db:g} dB at {hz:g} Hz" for hz, db in zip(
            demands.disturbance_hz, demands.attenuation_db, strict=True)),
        parameter=100 * demands.errors.parameter, noise_nm=1e3 * demands.sensor_noise_um,
        density=1e3 * demands.sensor_noise_um / np.sqrt(20e3),
        tolerance=100 * demands.disturbance_tolerance, peak=demands.worst_peak_sensitivity,
        low_hz=0.8 * light_hz, high_hz=1.2 * light_hz,
        peak_db=-20 * np.log10(2 * min(model.dynamics.damping_ratios)),
        added_nm=1e3 * demands.added_noise_um, voltage=demands.noise_voltage_v,
        default_voltage=Demands().noise_voltage_v)]
    for every_stage, title in TABLES:
        rows = [HEADER, ["---"] * len(HEADER),
                *(_row(row) for row in compared if row.of_every_stage == every_stage)]
        parts.append(f"## {title}\n\n" + _table(rows))
    if searches:
        parts.append(SEARCHES + "\n" + _table(searched_table(searches)))
    return "\n".join(parts)


def _table(rows):
    return "\n".join("| " + " | ".join(cells) + " |" for cells in rows) + "\n"
