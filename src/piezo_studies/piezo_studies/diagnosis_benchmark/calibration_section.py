# SPDX-License-Identifier: BSD-3-Clause
"""The sections of docs/studies/diagnosis_rates.md on the suite, and their pictures."""

from piezo_common.picture_style import new_figure, to_png
from piezo_studies.diagnosis_benchmark.coverage import KNOWN, coverage
from piezo_studies.diagnosis_benchmark.reliability import calibrate, draw_reliability
from piezo_studies.marked_sections import write_sections
from piezo_studies.tables import markdown_table


def write_section(page, document):
    """Replace the section `short cases` or `long cases` of a page by that of a `table.json`.

    Its picture is drawn, too. ValueError is raised if the page has no such section.
    """
    kind, results = document["kind"], document["results"]
    length, found = "short" if kind == "short" else "long", calibrate(results)
    picture = page.parent / "pictures" / f"diagnosis_{length}.png"
    first = markdown_table(
        ("probability of the first statement", "cases", "mean", "true"),
        [(f"{low:.1f} to {high:.1f}", str(count), f"{stated:.2f}", f"{true:.2f}")
         for low, high, stated, true, count in zip(
             found.edges[:-1], found.edges[1:], found.stated, found.true, found.counts,
             strict=True) if count])
    strict_error = calibrate(results, strict=True).expected_calibration_error
    figures = markdown_table(("figure", "value"), [
        *((f"{group}: {what}", str(count)) for group, counts in sorted(
            document["outcomes"].items()) for what, count in counts.items()),
        ("expected calibration error", f"{found.expected_calibration_error:.3f}"),
        ("the same of a calibrated program, mean", f"{found.calibrated_mean:.3f}"),
        ("in 95 of 100 of its runs at most", f"{found.calibrated_most:.3f}"),
        ("expected calibration error, strict", f"{strict_error:.3f}"), *_intervals(results)])
    write_sections(page, {f"{length} cases": (
        f"{len(results)} {kind} cases of seed {document['seed']}:\n\n{first}\n{figures}\n"
        f"![How often statements come true, over their probability](pictures/{picture.name})\n")})
    figure = new_figure()
    draw_reliability(figure.subplots(), found)
    picture.parent.mkdir(exist_ok=True)
    picture.write_bytes(to_png(figure))


def _intervals(results):
    """Return the rows of the table on the intervals of parameters."""
    whole = coverage(results)
    level = f"{100 * whole['level']:.0f} % intervals"
    found = {
        f"{level} that contain the parameter": whole,
        "the same, where it is explained": coverage(
            [each for each in results if each["verdict"] == "explained"]),
        "the same, of the parameter that was drawn": coverage(results, "drawn"),
        **{f"{level} of `{cause}`": shown for cause in KNOWN
           if (shown := coverage(_with_cause(results, cause)))["intervals"]}}
    return [(what, f"{each['right']} of {each['intervals']}") for what, each in found.items()]


def _with_cause(results, cause):
    return [result for result in results
            if cause in [entry["cause"] for entry in result.get("contributions", ())]]
