# SPDX-License-Identifier: BSD-3-Clause
"""The section of docs/studies/diagnosis_rates.md on the suite of long cases."""

from piezo_studies.diagnosis_benchmark.calibration import bin_table, error_rows
from piezo_studies.marked_sections import with_sections

SECTION = "calibration"
"""Mark of the section in the page."""


def section(document):
    """Return the text of the section.

    Parameters
    ----------
    document : dict
        Content of `table.json`.
    """
    calibration, intervals = document["calibration"], document["coverage"]
    kind = "that were there all along" if document["all_along"] else "of all kinds"
    lines = [
        f"{len(document['results'])} cases of seed {document['seed']}, with effects {kind}:", "",
        *bin_table(calibration), "", "| figure | value |", "|---|---|"]
    lines += [f"| {group}: {what} | {count} |"
              for group, counts in document["outcomes"].items() for what, count in counts.items()]
    lines += [
        *error_rows(calibration),
        f"| {100 * intervals['level']:.0f} % intervals that contain the parameter | "
        f"{intervals['right']} of {intervals['intervals']} |", ""]
    return "\n".join(lines)


def write_section(page, document):
    """Replace the section in a page; its other text is unchanged.

    Parameters
    ----------
    document : dict
        Content of `table.json`.

    Raises
    ------
    ValueError
        If the page has no such section.
    """
    text = page.read_text(encoding="utf-8")
    page.write_text(with_sections(text, {SECTION: section(document)}), encoding="utf-8")
