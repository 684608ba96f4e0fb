# SPDX-License-Identifier: BSD-3-Clause
"""The verdict of a diagnosis, and the files that contain it."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from piezo_common.summary_table import SummaryTable
from piezo_common.text_file import replace_json
from piezo_identification.diagnosis.comparison.reasons import Reason
from piezo_identification.diagnosis.verdict_view import (
    draw_verdict,
    summary_of_verdict,
    text_of_verdict,
)
from piezo_models.cascade import StageModel
from piezo_models.identified_model import IdentifiedModel
from piezo_models.model_file import save_model
from piezo_recorder.reading.reader import origin_of
from piezo_recorder.reading.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
    not_decidable: dict[str, str]
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
    reasons: dict[str, Reason] = field(default_factory=dict, kw_only=True)
    """Kind of reason for each of them."""
    confounded_with: dict[str, str] = field(default_factory=dict, kw_only=True)
    """Those that the data cannot distinguish from a named effect, and that effect."""
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

    def __repr__(self) -> str:
        return text_of_verdict(self)

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()

    def summary(self) -> SummaryTable:
        """Return errors and effects as a table, with standard deviations."""
        return summary_of_verdict(self)

    def plot(self) -> "Figure":
        """Draw errors and effects; see `verdict_view.draw_verdict`."""
        return draw_verdict(self)

    def without_undecided(self, names: Collection[str]) -> Self:
        """Return the verdict without undecided effects that are now decided."""
        left = [name for name in self.not_decidable if name not in names]
        return replace(
            self, not_decidable={name: self.not_decidable[name] for name in left},
            reasons={name: why for name, why in self.reasons.items() if name in left},
            confounded_with={name: other for name, other in self.confounded_with.items()
                           if name in left})

    def document(self) -> dict[str, Any]:
        """Return the content of `verdict.json`."""
        return {
            "verdict": self.verdict,
            "effects": self.effects,
            "before": self.before,
            "after": self.after,
            "noise_floor_um": self.noise_floor_um,
            "holdout": self.holdout,
            "not_decidable": list(self.not_decidable),
            "not_decidable_because": self.not_decidable,
            "not_decidable_reasons": self.reasons,
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


def write_verdict(path: Path, verdict: Verdict) -> None:
    """Write a verdict to its file, `verdict.json`."""
    replace_json(path, verdict.document())


def save_extended_model(path: Path, identified: IdentifiedModel, verdict: Verdict,
                        data: Sequence[str | PathLike[str] | Recording]) -> None:
    """Save the model with the effects of a verdict."""
    save_model(path, extended_model(identified, verdict, data))


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
