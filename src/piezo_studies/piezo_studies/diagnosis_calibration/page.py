# SPDX-License-Identifier: BSD-3-Clause
"""The section of docs/studies/diagnosis_rates.md on the calibration with small cases."""

from collections import Counter

from piezo_common.picture_style import new_figure, to_png
from piezo_studies.diagnosis_benchmark.calibration import (
    calibrate,
    draw_reliability,
    section_lines,
)
from piezo_studies.diagnosis_benchmark.coverage import KNOWN, coverage
from piezo_studies.diagnosis_benchmark.outcome import outcome
from piezo_studies.diagnosis_calibration.study import figures
from piezo_studies.marked_sections import write_sections

SECTION = "small cases"
"""Mark of the section in the page."""
PICTURE = "diagnosis_calibration.png"


def section(seed, results):
    """Return the text of the section."""
    reliability, intervals = figures(results)
    counts = Counter(outcome(result) for result in results)
    strict = calibrate(results, strict=True).expected_calibration_error
    explained = coverage([each for each in results if each["verdict"] == "explained"])
    level = f"{100 * intervals['level']:.0f} % intervals"
    return "\n".join([
        *section_lines(
            f"{len(results)} cases of seed {seed}:", reliability.document(),
            ((*what, count) for what, count in sorted(counts.items())),
            f"| expected calibration error, strict | {strict:.3f} |",
            f"| {level} that contain the parameter | {_right_of(intervals)} |",
            f"| the same, where it is explained | {_right_of(explained)} |",
            "| the same, of the parameter that was drawn | "
            f"{_right_of(coverage(results, 'drawn'))} |",
            *(f"| {level} of `{cause}` | {_right_of(found)} |" for cause in KNOWN
              if (found := coverage(_with_cause(results, cause)))["intervals"])),
        f"![How often statements come true, over their probability](pictures/{PICTURE})", "",
        "Table and picture are made by `make calibration`.", ""])


def _right_of(found):
    return f"{found['right']} of {found['intervals']}"


def _with_cause(results, cause):
    return [result for result in results
            if any(entry["cause"] == cause for entry in result["contributions"])]


def write_page(page, seed, results):
    """Replace the section of a page and its figure; the other text of the page is unchanged.

    Raises
    ------
    ValueError
        If the page has no such section.
    """
    write_sections(page, {SECTION: section(seed, results)})
    figure = new_figure()
    draw_reliability(figure.subplots(), figures(results)[0])
    picture = page.parent / "pictures" / PICTURE
    picture.parent.mkdir(exist_ok=True)
    picture.write_bytes(to_png(figure))
