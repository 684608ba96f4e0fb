# SPDX-License-Identifier: BSD-3-Clause
"""The page of a design: performance and margins of the loop, and its robustness."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from piezo_common.report_page import Section, pictured, render_page
from piezo_controller.feedback.robustness import PARAMETER_ERROR, Robustness

MARGINS = (("gain margin (1)", "gain_margin", "{:.3g}"),
           ("phase margin (degrees)", "phase_margin_deg", "{:.0f}"))
CAPTIONS = {
    "bode": ("Bode diagram", "Open loop with its margins, plant and controller; below, the closed "
             "loop with the bounds that the weights set, if there are any."),
    "nyquist": ("Nyquist diagram", "Open loop at the nominal gain of the hysteresis and at both "
                "ends of its spread. It must not enter the dotted circle about -1, which is that "
                "of the peak sensitivity."),
    "sensitivity": ("Sensitivity", "Part of a disturbance that remains, at each frequency; "
                    "above 1 the loop amplifies it. Grey, models with errors of all parameters."),
    "steps": ("Step responses", "The feedback alone, sampled once a tick; in a run the feedforward "
              "carries the reference. Grey, models with errors of all parameters."),
    "weights": ("Weights", "Weights of the H-infinity design."),
    "mu": ("Structured singular value", "Below 1, the demands hold for every error that the "
           "weights allow; right, from iterate to iterate."),
}


def page_of_loop(report: Mapping[str, Any], rows: Sequence[tuple[str, str]],
                 figures: Mapping[str, Figure], origin: Sequence[str], margins: Section) -> str:
    """Return the page of a design as HTML.

    The rows are those that the command prints, the figures have the names of `CAPTIONS`, and the
    origin names the files that the design is based on.
    """
    pictures = [pictured(name, figures[key], caption, closer=True,
                         wide=key in ("bode", "steps", "weights", "mu"))
                for key, (name, caption) in CAPTIONS.items() if key in figures]
    return render_page(_sentence(report), origin, [
        margins,
        Section("The loop", pictures=pictures),
        Section("All measures", ["Bandwidth: where the sensitivity first reaches -3 dB. Crossover: "
                                 "where the open loop first falls to 1. Rules (5.9) to (5.11) are "
                                 "those of the thesis."],
                [("measure", "value"), *((name.strip(), value) for name, value in rows)]),
    ])


def _sentence(report: Mapping[str, Any]) -> str:
    """Return one sentence on the performance of a loop."""
    parts = [layout.format(report[key]) for key, layout in (
        ("bandwidth_hz", "bandwidth {:.3g} Hz"), ("gain_margin", "gain margin {:.2g}"),
        ("phase_margin_deg", "phase margin {:.0f} degrees"),
        ("peak_sensitivity", "peak sensitivity {:.2g}")) if report.get(key) is not None]
    return (f"A feedback of order {report['order']} by {report['method'].replace('_', '-')}: "
            f"{', '.join(parts)}")


def margins_section(report: Mapping[str, Any], robustness: Robustness) -> Section:
    """Return the margins at the gains of the hysteresis, and the robustness, of one axis."""
    spread = report["hysteresis_gain_spread"]
    table: list[tuple[str, ...]] = [
        ("margin", f"lowest gain ({1 - spread:.2f})", "nominal gain",
         f"highest gain ({1 + spread:.2f})")]
    for name, key, layout in MARGINS:
        values = (report.get(key + where) for where in ("_at_lowest_gain", "", "_at_highest_gain"))
        table.append((name, *("none" if value is None else layout.format(value)
                              for value in values)))
    stable = robustness.samples - robustness.unstable_samples
    worst = ("unstable" if robustness.worst_peak_sensitivity == float("inf")
             else f"{robustness.worst_peak_sensitivity:.3g}")
    return Section("Margins", [
        "The gain of the hysteresis changes with its history between the lowest and the highest "
        "value, over the nominal one. The gain margin is the factor by which the gain may rise "
        "further, the phase margin the angle by which the phase may fall, until the loop is "
        "unstable; none stands where the loop crosses nothing.",
        f"Of {robustness.samples} models with random errors of up to {100 * PARAMETER_ERROR:.0f} % "
        f"of each parameter {stable} are stable. The peak of the sensitivity is "
        f"{report['peak_sensitivity']:.3g} nominally, and {worst} at the worst errors that were "
        "found."], table)
