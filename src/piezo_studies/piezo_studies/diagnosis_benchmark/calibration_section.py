# SPDX-License-Identifier: BSD-3-Clause
"""The section of docs/studies/diagnosis_rates.md on the suite of long cases."""

from piezo_studies.diagnosis_benchmark.calibration import section_lines
from piezo_studies.marked_sections import write_sections

SECTION = "calibration"
"""Mark of the section in the page."""


def write_section(page, document):
    """Replace the section in a page by that of a content of `table.json`.

    Raises
    ------
    ValueError
        If the page has no such section.
    """
    intervals = document["coverage"]
    kind = "that were there all along" if document["all_along"] else "of all kinds"
    lines = section_lines(
        f"{len(document['results'])} cases of seed {document['seed']}, with effects {kind}:",
        document["calibration"],
        ((group, what, count) for group, counts in document["outcomes"].items()
         for what, count in counts.items()),
        f"| {100 * intervals['level']:.0f} % intervals that contain the parameter | "
        f"{intervals['right']} of {intervals['intervals']} |")
    write_sections(page, {SECTION: "\n".join(lines)})
