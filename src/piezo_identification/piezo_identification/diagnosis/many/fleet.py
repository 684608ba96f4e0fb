# SPDX-License-Identifier: BSD-3-Clause
"""Comparison of the recordings of a fleet: which stage ages, and since when."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from piezo_common.picture_style import CURVES, label, new_figure
from piezo_common.report_page import Section, pictured
from piezo_identification.diagnosis.many.many_recordings import DiagnosisRow

FLEET_HEADS = ("stage", "recordings", "from", "to", "last verdict", "effects", "since",
               "error, first (nm)", "error, last (nm)")

DAY_S = 86_400.0
NM_PER_UM = 1e3


@dataclass(frozen=True)
class StageHistory:
    """Diagnoses of one stage, the oldest recording first."""

    stage: str
    recorded: tuple[datetime, ...]
    verdicts: tuple[dict[str, Any], ...]

    @property
    def since(self) -> datetime | None:
        """Time since when each recording shows that the model lacks something, or None."""
        poor = [verdict["verdict"] != "none" for verdict in self.verdicts]
        fine = [number for number, is_poor in enumerate(poor) if not is_poor]
        begin = fine[-1] + 1 if fine else 0
        return self.recorded[begin] if begin < len(poor) else None

    def errors_nm(self) -> list[float]:
        """Return the RMS error of the model in each recording."""
        return [NM_PER_UM * verdict["before"]["rms_um"] for verdict in self.verdicts]

    def row(self) -> list[str]:
        """Return the cells of the stage, in the order of `FLEET_HEADS`."""
        last, errors_nm = self.verdicts[-1], self.errors_nm()
        return [self.stage, str(len(self.verdicts)), _day(self.recorded[0]),
                _day(self.recorded[-1]), last["verdict"],
                ", ".join(effect["name"] for effect in last["effects"]),
                "" if self.since is None else _day(self.since),
                f"{errors_nm[0]:.3g}", f"{errors_nm[-1]:.3g}"]


def histories(rows: Sequence[DiagnosisRow],
              results: Sequence[dict[str, Any]]) -> list[StageHistory]:
    """Return the history of each stage, those with the longest lack first.

    Parameters
    ----------
    rows : sequence of DiagnosisRow
        Rows without a stage or a time of recording are omitted.
    results : sequence of dict
        Results of `diagnose_row`, in the same order.
    """
    of_stages: dict[str, list[tuple[datetime, dict[str, Any]]]] = defaultdict(list)
    for row, result in zip(rows, results, strict=True):
        if row.stage and row.recorded and "verdict" in result:
            of_stages[row.stage].append((row.recorded, result["verdict"]))
    found = []
    for stage, entries in of_stages.items():
        entries.sort(key=lambda entry: entry[0])
        times, verdicts = zip(*entries, strict=True)
        found.append(StageHistory(stage, times, verdicts))
    return sorted(found, key=lambda each: (each.since is None, each.since or each.recorded[0]))


def fleet_section(found: Sequence[StageHistory]) -> Section:
    """Return the section of a page that compares the stages."""
    poor = sum(each.since is not None for each in found)
    return Section("Stages", [
        f"{poor} of {len(found)} stages show an effect that their model lacks. Since: the first "
        "recording from which on each of a stage does. Error: RMS of the given model."],
        [FLEET_HEADS, *(each.row() for each in found)],
        [pictured("Errors of the stages", fleet_figure(found),
                  "Error of the model in each recording; filled where the model lacks an effect.",
                  wide=True)])


def fleet_figure(found: Sequence[StageHistory]) -> Figure:
    """Draw the error of each stage's model over time."""
    figure = new_figure(4.2)
    axes = figure.subplots()
    first = min(each.recorded[0] for each in found)
    for number, each in enumerate(found):
        style = CURVES[number % len(CURVES)]
        days = np.array([(time - first).total_seconds() for time in each.recorded]) / DAY_S
        errors_nm = np.array(each.errors_nm())
        axes.semilogy(days, errors_nm, label=each.stage, **style)
        is_poor = np.array([verdict["verdict"] != "none" for verdict in each.verdicts])
        for chosen, face in ((is_poor, style["color"]), (~is_poor, "white")):
            axes.plot(days[chosen], errors_nm[chosen], linestyle="none", marker="o",
                      color=style["color"], markerfacecolor=face)
    axes.legend(fontsize="small")
    label(axes, f"days since {_day(first)}", "RMS error of the model (nm)")
    return figure


def _day(time: datetime) -> str:
    return time.date().isoformat()
