# SPDX-License-Identifier: BSD-3-Clause
"""The page that summarises many diagnoses."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from piezo_common.report_page import Section, render_page
from piezo_identification.diagnosis.many.fleet import fleet_section, histories
from piezo_identification.diagnosis.many.many_recordings import DiagnosisRow, errors_of

HEADS = ("name", "verdict", "effects", "most probable", "probability", "before (nm)", "after (nm)",
         "noise (nm)")


def many_page(rows: Sequence[DiagnosisRow], results: Sequence[dict[str, Any]],
              origin: Sequence[str]) -> str:
    """Return the page of many diagnoses as HTML; that of a fleet begins with its stages.

    Parameters
    ----------
    results : sequence of dict
        Results of `diagnose_row`, in the order of the rows.
    """
    verdicts = [result for result in results if "verdict" in result]
    counts = Counter(result["verdict"]["verdict"] for result in verdicts)
    effects = Counter(entry["name"] for result in verdicts
                      for entry in result["verdict"]["effects"])
    counted = ", ".join(f"{count} {name}" for name, count in counts.most_common()) or "none"
    skipped = list(errors_of(results))
    of_stages = histories(rows, results)
    sections = [fleet_section(of_stages)] if of_stages else []
    sections += [Section(
        "Recordings", [f"The report of each row is `report.html` in the folder of its name. "
                       f"{len(skipped)} could not be diagnosed."],
        [HEADS, *map(summary_row, verdicts)])]
    if effects:
        sections.append(Section("Effects", table=[
            ("effect", "recordings"),
            *((name, str(count)) for name, count in effects.most_common())]))
    if skipped:
        sections.append(Section("Skipped", skipped))
    return render_page(f"{len(verdicts)} of {len(results)} diagnosed: {counted}", origin, sections)


def summary_row(result: dict[str, Any]) -> list[str]:
    """Return the cells of one diagnosis, in the order of `HEADS`."""
    verdict = result["verdict"]
    chances = verdict.get("probabilities") or {}
    likely = max(chances, key=lambda name: chances[name], default="")
    return [result["name"], verdict["verdict"],
            ", ".join(entry["name"] for entry in verdict["effects"]), likely,
            f"{chances[likely]:.3f}" if likely else "",
            *(f"{1e3 * each:.3g}" for each in (
                verdict["before"]["rms_um"], verdict["after"]["rms_um"],
                verdict["noise_floor_um"]))]
