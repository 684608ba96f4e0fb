# SPDX-License-Identifier: BSD-3-Clause
"""The section of docs/diagnosis.md on the calibration of probabilities and intervals."""

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
    calibrated = calibration["of_a_calibrated_program"]
    kind = "that were there all along" if document["all_along"] else "of all kinds"
    lines = [
        f"{len(document['results'])} cases of seed {document['seed']}, with effects {kind}:", "",
        "| probability of the first statement | cases | mean | true |", "|---|---|---|---|"]
    lines += [f"| {each['from']:.1f} to {each['to']:.1f} | {each['cases']} | "
              f"{each['stated']:.2f} | {each['true']:.2f} |"
              for each in calibration["bins"] if each["cases"]]
    lines += ["", "| figure | value |", "|---|---|"]
    lines += [f"| {group}: {what} | {count} |"
              for group, counts in document["outcomes"].items() for what, count in counts.items()]
    lines += [
        f"| expected calibration error | {calibration['expected_calibration_error']:.3f} |",
        f"| the same of a calibrated program, mean | {calibrated['mean']:.3f} |",
        f"| in 95 of 100 of its runs at most | {calibrated['most']:.3f} |",
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
