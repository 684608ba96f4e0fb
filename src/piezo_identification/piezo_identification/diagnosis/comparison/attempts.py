# SPDX-License-Identifier: BSD-3-Clause
"""Trial of each known effect in addition to those found."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from piezo_common.side_by_side import side_by_side
from piezo_identification.diagnosis.comparison.criteria import CRITERIA
from piezo_identification.diagnosis.comparison.measures_of_fits import (
    distance,
    mean_square,
    significance,
    visible_part,
)
from piezo_identification.diagnosis.comparison.reasons import OTHER_PARAMETERS, Reason, Undecided
from piezo_identification.fitting.effect_fit import fit_one_more, impossible_effects
from piezo_identification.fitting.recording_evidence import recording_evidence
from piezo_identification.fitting.regression import Fit, Regression
from piezo_models.effects import Effect, Evidence


@dataclass(frozen=True, eq=False)
class Attempt:
    """A candidate in one round of the comparison."""

    name: str

    fit: Fit | None
    """None if the data give no initial guess, or cannot show the effect."""
    significance: float = 0.0
    """Significance of the gain on held-out data, in standard deviations."""
    reduction_percent: float = 0.0
    """Reduction of the RMS error on held-out data."""
    size: float = 0.0
    """RMS of the contribution, in tolerances."""
    undecided: Undecided | None = None
    """Why the data could not show the effect; None if they could."""


def try_each(regression: Regression, kinds: Sequence[type[Effect]], current: Fit,
             report: Callable[[str, float], None]) -> list[Attempt]:
    """Try each kind of effect in addition to those of a fit."""
    evidence = recording_evidence(regression, current.effects)
    return side_by_side(
        lambda kind: _attempt(regression, kind, current, evidence), kinds,
        lambda number: report(kinds[number].name, number / len(kinds)))


def _attempt(regression: Regression, kind: type[Effect], current: Fit,
             evidence: Sequence[Evidence]) -> Attempt:
    if not kind.several and any(type(effect) is kind for effect in current.effects):
        return Attempt(kind.name, None)
    unexcited = [kind.lacks_excitation(shown) for shown in evidence]
    if all(unexcited):
        return Attempt(kind.name, None, undecided=Undecided(
            Reason.NOT_EXCITED, str(unexcited[0])))
    fit = fit_one_more(regression, kind, current.effects, evidence)
    if fit is None:
        return Attempt(kind.name, None)
    impossible = impossible_effects(fit, regression.dataset.extent)
    if impossible:
        return Attempt(kind.name, None, undecided=Undecided(
            Reason.IMPOSSIBLE, "; ".join(impossible.values())))
    before, after = mean_square(regression, current), mean_square(regression, fit)
    is_visible = visible_part(regression, current, fit) >= CRITERIA.visible
    return Attempt(
        kind.name, fit, significance(regression, current, fit),
        float(100.0 * (1.0 - np.sqrt(after / before))), distance(regression, current, fit),
        None if is_visible else OTHER_PARAMETERS,
    )
