# SPDX-License-Identifier: BSD-3-Clause
"""The verdict of a diagnosis, and the files that contain it."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from piezo_common.summary_table import Cell, SummaryTable
from piezo_common.text_file import replace_json
from piezo_identification.diagnosis.comparison.criteria import Undecided
from piezo_identification.diagnosis.evidence.effect_entries import name_of
from piezo_models.cascade import StageModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import origin_of
from piezo_recorder.reading.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEADS = ("", "value", "std. dev.", "unit")


@dataclass(frozen=True, eq=False, repr=False)
class Verdict:
    """What a model lacks, and how much the effects found improve it."""

    verdict: str
    """One of "none", "explained" or "unexplained"."""
    effects: list[dict[str, Any]]
    """Name, parameters and error reduction of each effect."""
    model: StageModel
    """Model extended by the effects; the given one if there are none."""
    before: dict[str, float]
    after: dict[str, float]
    """`rms_um` and `e_y_percent` on held-out data."""
    noise_floor_um: float

    holdout: dict[str, object]
    """Source of the held-out data, and number of samples."""
    undecided: dict[str, Undecided]
    """Effects that the data can neither show nor exclude, and why."""
    left: str
    """Sentence on the residual if it is more than noise, or the noise is unknown; otherwise
    empty."""
    reversed: list[str]
    """Recordings whose sign was changed, because the sensor has the opposite direction."""
    left_out: list[str]
    """Sentences on the samples that were excluded as outliers."""
    ceiling: dict[str, float] | None
    """Part of the residual that a learner without knowledge of stages predicts; None if the
    residual is compatible with known noise, or if not computed. See `evidence.ceiling.Ceiling`."""
    confounded_with: dict[str, str] = field(default_factory=dict, kw_only=True)
    """Undecided effects that the data cannot distinguish from a named effect, and that effect."""
    probabilities: dict[str, float] = field(default_factory=dict, kw_only=True)
    """Probability of each relevant set of effects (names joined by +), of `none` and of
    `something_else`, in descending order; they sum to one. Empty if not computed."""
    identified_from: dict[str, object] = field(default_factory=dict, kw_only=True)
    """`recordings` of the identification that were also used, and in `not_asked` what could not be
    determined without the others; empty if none were used."""
    recording_faults: list[dict[str, object]] = field(default_factory=list, kw_only=True)
    """Faults of the recordings: `name` (`wrong_sign`, `misaligned_rows`), `recording`, `sentence`,
    `remedy` and related numbers. See `evidence.recording_faults`."""
    next_experiment: dict[str, Any] | None = field(default=None, kw_only=True)
    """The recording that would decide between the remaining explanations, and what each of them
    predicts; None if it was not designed. See `experiment_design.propose.Proposal`."""
    not_tried: str = field(default="", kw_only=True)
    """Why the comparison ended early, and what it has not tried; empty if it was completed."""

    @property
    def not_decidable(self) -> dict[str, str]:
        """Return a sentence for each undecided effect."""
        return {name: why.sentence for name, why in self.undecided.items()}

    def __repr__(self) -> str:
        named = " and ".join(map(name_of, self.effects))
        before, after = (errors["rms_um"] for errors in (self.before, self.after))
        return (f"<{type(self).__name__}: {self.verdict}{' by ' if named else ''}{named}, "
                f"{1e3 * before:.4g} nm RMS before, {1e3 * after:.4g} nm after, "
                f"{1e3 * self.noise_floor_um:.4g} nm noise>")

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()

    def summary(self) -> SummaryTable:
        """Return errors on held-out data and effects as a table, with standard deviations."""
        rows: list[tuple[Cell, ...]] = []
        for when, errors in (("before", self.before), ("after", self.after)):
            rows += [(f"RMS error, {when}", 1e3 * errors["rms_um"], None, "nm"),
                     (f"relative error e_y, {when}", errors["e_y_percent"], None, "%")]
        rows.append(("noise of the sensor", 1e3 * self.noise_floor_um, None, "nm"))
        for entry in self.effects:
            rows += _effect_rows(entry)
        rows += [(f"probability of {name}", 100.0 * value, None, "%")
                 for name, value in self.probabilities.items()]
        notes = [*(str(fault["sentence"]) for fault in self.recording_faults),
                 *self.left_out, self.left,
                 *(f"{name} cannot be decided: {why}" for name, why in self.not_decidable.items())]
        held_out = "{samples} samples of {source}".format(**self.holdout)
        return SummaryTable(f"Verdict: {self.verdict}; errors on {held_out}", HEADS, rows,
                            tuple(filter(None, notes)))

    def plot(self) -> "Figure":
        """Draw the errors before and after with the noise, and the reduction by each effect."""
        from piezo_common.picture_style import BLACK, BLUE, GREY, ORANGE, WIDE_IN, label, new_figure

        figure = new_figure(3.0, WIDE_IN)
        errors, effects = figure.subplots(1, 2)
        errors.barh(["noise", "after", "before"], [1e3 * value for value in (
            self.noise_floor_um, self.after["rms_um"], self.before["rms_um"])],
            color=[GREY, BLUE, ORANGE])
        label(errors, "RMS error on held-out data (nm)", None, f"verdict: {self.verdict}")
        found = self.effects[::-1]
        effects.barh([entry["name"] for entry in found],
                     [entry["error_reduction_percent"] for entry in found], color=BLUE)
        effects.set_xlim(0.0, 100.0)
        label(effects, "error reduction (%)", None, "effects")
        if not found:
            effects.text(50.0, 0.0, "no effect is named", ha="center", va="center", color=BLACK)
            effects.set(yticks=[], ylim=(-1.0, 1.0))
        return figure

    def without_undecided(self, names: Collection[str]) -> Self:
        """Return the verdict without undecided effects that are now decided."""
        return replace(
            self, undecided={name: why for name, why in self.undecided.items()
                             if name not in names},
            confounded_with={name: other for name, other in self.confounded_with.items()
                             if name not in names})

    def document(self) -> dict[str, Any]:
        """Return the content of `verdict.json`."""
        return {
            "verdict": self.verdict,
            "effects": self.effects,
            "before": self.before,
            "after": self.after,
            "noise_floor_um": self.noise_floor_um,
            "holdout": self.holdout,
            "not_decidable": list(self.undecided),
            "not_decidable_because": self.not_decidable,
            "not_decidable_reasons": {name: why.reason for name, why in self.undecided.items()},
            "not_told_from": self.confounded_with,
            "left": self.left,
            "reversed": self.reversed,
            "outliers_left_out": self.left_out,
            "ceiling": self.ceiling,
            "probabilities": self.probabilities,
            "identified_from": self.identified_from,
            "recording_faults": self.recording_faults,
            "next_experiment": self.next_experiment,
            "interrupted": bool(self.not_tried),
            "not_tried": self.not_tried,
        }


def write_verdict(directory: Path, identified: IdentifiedModel, verdict: Verdict,
                  data: Sequence[str | PathLike[str] | Recording]) -> None:
    """Write `verdict.json`, and the model with the effects of a verdict, `extended_model.json`."""
    replace_json(directory / "verdict.json", verdict.document())
    save_model(directory / "extended_model.json", extended_model(identified, verdict, data))


def extended_model(identified: IdentifiedModel, verdict: Verdict,
                   data: Sequence[str | PathLike[str] | Recording]) -> IdentifiedModel:
    """Return the model with the effects of a verdict and the origin of the diagnosed data.

    It is the given one if nothing was added.
    """
    if verdict.model is identified.model:
        return identified
    return replace(
        identified, model=verdict.model, uncertainties={}, adequacy={}, unfinished="",
        errors={**identified.errors, "before_diagnosis": verdict.before,
                "after_diagnosis": verdict.after},
        recordings=[*identified.recordings, *map(origin_of, data)])


def _effect_rows(entry: dict[str, Any]) -> Iterator[tuple[Cell, ...]]:
    yield (f"{name_of(entry)}, error reduction", entry["error_reduction_percent"], None, "%")
    deviations = entry.get("standard_deviations", {})
    for name, value in entry["parameters"].items():
        values = np.atleast_1d(value)
        known = np.atleast_1d(deviations.get(name, [None] * values.size))
        for number, (each, deviation) in enumerate(zip(values, known, strict=True), 1):
            counted = f" {number}" if values.size > 1 else ""
            yield (f"{entry['name']}, {name}{counted}", float(each),
                   None if deviation is None else float(deviation), "")
