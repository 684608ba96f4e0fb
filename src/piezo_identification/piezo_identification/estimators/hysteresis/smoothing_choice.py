# SPDX-License-Identifier: BSD-3-Clause
"""Weights of the density's penalties, chosen by the prediction of held-out branches."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_common.budget import has_time_for, while_time_lasts
from piezo_common.side_by_side import side_by_side
from piezo_identification.conditioning.waveforms import REVERSAL, turning_points
from piezo_identification.estimators.hysteresis.equations import (
    Equations,
    HysteresisSegment,
    Penalties,
    equations_of_folds,
)

SMOOTHING_WEIGHTS = tuple(10.0**power for power in range(-6, -19, -1))
"""Weights of the density's curvature, in descending order."""

FOLDS = 5
"""Number of folds of the branches, each held out once; odd, so that they mix both directions."""

MOST_ABOVE_THE_LEAST = 0.1
"""Largest relative excess of a mean square over the smallest one. If some folds are far larger than
others, the standard error alone would admit any density, even a line."""

RISES = 3
"""Number of successive weights, each of which predicts worse than the one before, that ends a
search. The following ones would take most time, because some of the bounds then become active."""

FURTHER_WEIGHTS, WEIGHTS = "further weights of the density", 0.5
"""What is omitted when time is short, and the share of the time limit after which it is."""

USUAL = 1e-10
"""Weight of the curvature if there is no time to choose: 1e-9 to 1e-11 are usual."""

FEWEST_ROWS = 4
"""Fewest fitted samples in a piece of a branch."""


@dataclass(frozen=True, eq=False)
class PenaltyChoice:
    """The chosen weights."""

    penalties: Penalties

    forces: FloatArray
    """Multipliers of the bounds, on the grid on which the weights were chosen."""
    misfit: float
    """Sum of squared errors on held-out samples."""
    is_enough: bool
    """True if a line, or the hysteresis about which it is smoothed, predicts them as well."""


def branch_folds(segments: Sequence[HysteresisSegment]) -> list[NDArray[np.intp]]:
    """Return, for each sample to fit, the number of the fold in which it is held out.

    Whole branches between reversals are held out, because neighbouring samples carry the same
    information. If there are few branches, they are divided into pieces.
    """
    branches = [_branches(segment) for segment in segments]
    count = sum(len(np.unique(each)) for each in branches)
    pieces = max(1, -(-2 * FOLDS // max(count, 1)))
    folds, first = [], 0
    for branch in branches:
        number = np.zeros(branch.size, dtype=int)
        for each in np.unique(branch):
            rows = np.flatnonzero(branch == each)
            parts = max(1, min(pieces, rows.size // FEWEST_ROWS))
            number[rows] = first + np.arange(rows.size) * parts // rows.size
            first += parts
        folds.append(number % FOLDS)
    return folds


def _branches(segment: HysteresisSegment) -> NDArray[np.intp]:
    """Return the number of the branch of each sample to fit."""
    voltage_v = segment.voltage_v
    points = turning_points(voltage_v, REVERSAL * float(np.ptp(voltage_v)))
    return np.searchsorted(points[1:-1], segment.samples, side="right")


def choose_penalties(
    segments: Sequence[HysteresisSegment], levels_v: FloatArray, translation: float = 0.0,
    about: FloatArray | None = None,
) -> PenaltyChoice:
    """Choose the largest weight of the curvature that predicts held-out branches as well as any.

    "As well as any" means that the mean over the folds is worse by no more than the standard error
    of the difference, or the random variation of a mean square. The levels are (n + 1,), and
    `translation` is the weight of the change along the diagonal; for `about` see `Equations`.
    """
    trials = _Trials(equations_of_folds(segments, levels_v, branch_folds(segments), about))
    penalties = trials.best(
        Penalties(weight, translation) for weight in SMOOTHING_WEIGHTS
    ) if has_time_for(FURTHER_WEIGHTS, WEIGHTS) else trials.best_near(
        Penalties(USUAL, translation))
    return PenaltyChoice(
        penalties, trials.forces(penalties), float(trials.misfits(penalties).sum()),
        trials.nothing_more_predicts(penalties))


def refine_smoothing(
    segments: Sequence[HysteresisSegment], levels_v: FloatArray, choice: PenaltyChoice,
    forces: FloatArray, about: FloatArray | None = None,
) -> PenaltyChoice:
    """Continue from weights that were chosen on few cells to a smoothing for more of them.

    Errors of a coarse grid hide how much curvature the density may have. Levels, approximate
    multipliers of the bounds (`forces`), and `about` (see `Equations`) are those of the finer grid.
    """
    trials = _Trials(
        equations_of_folds(segments, levels_v, branch_folds(segments), about), forces)
    penalties = trials.best_near(choice.penalties)
    return replace(choice, penalties=penalties, forces=trials.forces(penalties))


class _Trials:
    """Errors of held-out folds, by the penalties."""

    def __init__(
        self, folds: Sequence[Equations], forces: FloatArray | None = None,
    ) -> None:
        self._unseen = [fold for fold in folds if fold.count]
        whole = self._unseen[0]
        for fold in self._unseen[1:]:
            whole = whole.plus(fold)
        self._whole = whole
        self._fitted = [whole.plus(fold, -1.0) if len(self._unseen) > 1 else whole
                        for fold in self._unseen]
        self._counts = np.array([fold.count for fold in self._unseen])
        self._misfits: dict[Penalties, FloatArray] = {}
        self._first_forces = forces
        self._forces: dict[Penalties, list[FloatArray]] = {}

    def misfits(self, penalties: Penalties) -> FloatArray:
        """Sum of the squared errors of each fold."""
        if penalties not in self._misfits:
            def fitted(index: int, forces: FloatArray | None) -> tuple[float, FloatArray]:
                unknowns, _, forces = self._fitted[index].solve(penalties, forces, is_rough=True)
                return self._unseen_misfit(self._unseen[index], unknowns), forces

            # The active bounds are nearly those of similar weights, and the same in all folds.
            known = self._forces_near(penalties)
            first = fitted(0, known[0] if known else self._first_forces)
            misfits, self._forces[penalties] = (list(each) for each in zip(first, *side_by_side(
                lambda index: fitted(index, known[index] if known else first[1]),
                range(1, len(self._fitted))), strict=True))
            self._misfits[penalties] = np.array(misfits)
        return self._misfits[penalties]

    def _forces_near(self, penalties: Penalties) -> list[FloatArray]:
        """Return the multipliers of the most similar weights, by folds; empty if there are none."""
        def decades(known: Penalties) -> float:
            return float(abs(np.log10(known.smoothing / penalties.smoothing)))

        return self._forces[min(self._forces, key=decades)] if self._forces else []

    def best(self, candidates: Iterable[Penalties]) -> Penalties:
        """Return the first candidate that predicts as well as any; stop when they get worse."""
        first, *others = candidates
        listed, misfits = [first], [float(self.misfits(first).sum())]
        with while_time_lasts(FURTHER_WEIGHTS, WEIGHTS):
            for penalties in others:
                misfits.append(float(self.misfits(penalties).sum()))
                listed.append(penalties)
                if len(misfits) > RISES and np.all(np.diff(misfits[-RISES - 1 :]) > 0.0):
                    break
        least = listed[int(np.argmin(misfits))]
        return next(each for each in listed if self._as_well(self.misfits(each), least))

    def best_near(self, penalties: Penalties) -> Penalties:
        """Return the best smoothing that is reached from a given one.

        Smaller weights are tried as long as they predict the held-out branches better; if the first
        does not, larger ones are tried.
        """
        first = SMOOTHING_WEIGHTS.index(penalties.smoothing)
        tried, least = [penalties], self.misfits(penalties).sum()
        with while_time_lasts(FURTHER_WEIGHTS):
            for weights in (SMOOTHING_WEIGHTS[first + 1 :], SMOOTHING_WEIGHTS[:first][::-1]):
                for weight in weights:
                    further = replace(penalties, smoothing=weight)
                    misfit = self.misfits(further).sum()
                    tried.append(further)
                    if misfit >= least:
                        break
                    least = misfit
                if len(tried) > 2:
                    break
        return self.best(sorted(tried, key=lambda each: -each.smoothing))

    def forces(self, penalties: Penalties) -> FloatArray:
        """Return the multipliers of the bounds for all samples."""
        self.misfits(penalties)
        return self._whole.solve(penalties, self._forces[penalties][0], is_rough=True)[2]

    def nothing_more_predicts(self, penalties: Penalties) -> bool:
        """Return whether a line, or the given hysteresis alone, predicts as well as a density."""
        nothing = np.zeros(self._whole.about.size)
        misfits = np.array([
            self._unseen_misfit(
                unseen, nothing if self._whole.about.any() else fitted.solve_line()[0])
            for fitted, unseen in zip(self._fitted, self._unseen, strict=True)
        ])
        return self._as_well(misfits, penalties)

    def _unseen_misfit(self, unseen: Equations, unknowns: FloatArray) -> float:
        """Sum of the squared errors of a fold.

        Offsets and transients do not belong to the hysteresis and are fitted to all samples. A
        transient may lie in one fold only, so that the other folds do not determine it.
        """
        return unseen.misfit(unknowns, self._whole.coefficients(unknowns))

    def _as_well(self, misfits: FloatArray, least: Penalties) -> bool:
        best = self.misfits(least)
        worse = (misfits - best) / self._counts
        error = float(np.std(worse) / np.sqrt(max(worse.size - 1, 1)))
        chance = np.sqrt(2.0 / self._counts.sum()) * best.sum() / self._counts.sum()
        most = MOST_ABOVE_THE_LEAST * best.sum() / self._counts.sum()
        # For exact data, the misfits are rounding errors of either sign.
        return float(np.mean(worse)) <= max(min(error, most), chance, 0.0)
