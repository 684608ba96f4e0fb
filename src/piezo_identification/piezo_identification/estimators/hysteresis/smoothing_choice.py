# SPDX-License-Identifier: BSD-3-Clause
"""The weights of the density's penalties that predict branches held out."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_common.budget import has_time_for, while_time_lasts
from piezo_common.side_by_side import side_by_side
from piezo_identification.conditioning.waveforms import turning_points
from piezo_identification.estimators.hysteresis.equations import (
    Equations,
    HysteresisSegment,
    Penalties,
    equations_of_folds,
)

SMOOTHING_WEIGHTS = tuple(10.0**power for power in range(-6, -19, -1))
"""Weights of the density's curvature, from the largest down."""

TRANSLATION_WEIGHTS = tuple(10.0**power for power in range(-6, -12, -1))
"""Weights of the density's change along the diagonal, from the largest down."""

FOLDS = 5
"""Parts of the branches, each held out once; odd, so that ways up and down take turns."""

SHORT_BRANCH = 0.02
"""A way back by less than this part of the voltage's range is no branch of its own."""

MOST_ABOVE_THE_LEAST = 0.1
"""Part by which a mean square may exceed the least, however much the folds differ: where some hold
far more than others, the standard error excuses anything, even a line."""

RISES = 3
"""So many weights in a row, each of which predicts worse than the one before, end a search: those
that would follow take most time, as the bounds then hold here and there."""

FURTHER_WEIGHTS, WEIGHTS = "further weights of the density", 0.5
"""What is left out, and from which share of the time of an identification."""

USUAL = 1e-10
"""Weight of the curvature where there is no time to choose: most choose 1e-9 to 1e-11."""

FEWEST_ROWS = 4
"""Samples to fit in a piece of a branch."""


@dataclass(frozen=True, eq=False)
class PenaltyChoice:
    """The chosen weights.

    Parameters
    ----------
    without_translation : Penalties
        Those to take where the density's change along the diagonal is not to be charged.
    forces : ndarray
        Of the bounds, on the grid on which the weights were chosen.
    misfit : float
        Sum of the squared errors of what was held out.
    is_enough : bool
        A line, or what it is smoothed about alone, predicts what was held out as well.
    """

    penalties: Penalties
    without_translation: Penalties
    forces: FloatArray
    misfit: float
    is_enough: bool


def branch_folds(segments: Sequence[HysteresisSegment]) -> list[NDArray[np.intp]]:
    """Return, for each sample to fit, the number of the fold in which they are held out.

    Whole branches between reversals are held out, as samples beside each other tell the same. Where
    there are few, they are cut into pieces.
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
    points = turning_points(voltage_v, SHORT_BRANCH * float(np.ptp(voltage_v)))
    return np.searchsorted(points[1:-1], segment.samples, side="right")


def choose_penalties(
    segments: Sequence[HysteresisSegment], levels_v: FloatArray, translation: float | None = None,
    about: FloatArray | None = None, near: Penalties | None = None,
) -> PenaltyChoice:
    """Choose the weights that predict branches held out as well as any.

    Of those, the largest of the curvature; of the change along the diagonal the smallest, and none
    unless it predicts better, because few stages are alike along it. As well as any: the mean over
    the folds is worse by no more than the standard error of the difference, or than chance does to
    a mean square.

    Parameters
    ----------
    levels_v : ndarray, shape (n + 1,)
    translation : float, optional
        Weight of the change along the diagonal; by default chosen too.
    about : ndarray, optional
        See `Equations`.
    near : Penalties, optional
        Chosen from nearly the same segments: the smoothing is sought from there.
    """
    trials = _Trials(equations_of_folds(segments, levels_v, branch_folds(segments), about))
    if near is None and not has_time_for(FURTHER_WEIGHTS, WEIGHTS):
        near = Penalties(USUAL, translation or 0.0)
    if near is not None:
        penalties = trials.best_near(near)
        # About plays nothing asks for another.
        free = penalties if about is not None else trials.best_near(
            replace(near, translation=translation or 0.0))
    else:
        penalties = free = trials.best(
            Penalties(weight, translation or 0.0) for weight in SMOOTHING_WEIGHTS)
    if translation is None and near is None:
        penalties = trials.best(
            replace(penalties, translation=weight)
            for weight in (0.0, *reversed(TRANSLATION_WEIGHTS)))
        penalties = trials.best(
            replace(penalties, smoothing=weight) for weight in SMOOTHING_WEIGHTS)
    return PenaltyChoice(
        penalties, free, trials.forces(penalties), float(trials.misfits(penalties).sum()),
        trials.nothing_more_predicts(penalties))


def refine_smoothing(
    segments: Sequence[HysteresisSegment], levels_v: FloatArray, choice: PenaltyChoice,
    forces: FloatArray, about: FloatArray | None = None,
) -> PenaltyChoice:
    """Go on from weights that were chosen on few cells to a smoothing for more of them.

    What few cells cannot follow hides from them how much the density may bend.

    Parameters
    ----------
    levels_v : ndarray, shape (n + 1,)
        Of the finer grid.
    forces : ndarray
        Of the bounds on the finer grid, about.
    about : ndarray, optional
        See `Equations`; on the finer grid.
    """
    trials = _Trials(
        equations_of_folds(segments, levels_v, branch_folds(segments), about), forces)
    penalties = trials.best_near(choice.penalties)
    return replace(choice, penalties=penalties, forces=trials.forces(penalties))


class _Trials:
    """Misfits of the folds held out, by the penalties."""

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
                unknowns, _, forces = self._fitted[index].solve(penalties, forces)
                return self._unseen_misfit(self._unseen[index], unknowns), forces

            # The bounds that hold are nearly those of weights nearby, and the same in all folds.
            known = self._forces_near(penalties)
            first = fitted(0, known[0] if known else self._first_forces)
            misfits, self._forces[penalties] = (list(each) for each in zip(first, *side_by_side(
                lambda index: fitted(index, known[index] if known else first[1]),
                range(1, len(self._fitted))), strict=True))
            self._misfits[penalties] = np.array(misfits)
        return self._misfits[penalties]

    def _forces_near(self, penalties: Penalties) -> list[FloatArray]:
        """Return the forces of the weights nearest to some, by the folds; none before any."""
        def decades(known: Penalties) -> float:
            return abs(np.log10(known.smoothing / penalties.smoothing)) + (
                known.translation != penalties.translation)

        return self._forces[min(self._forces, key=decades)] if self._forces else []

    def best(self, candidates: Iterable[Penalties]) -> Penalties:
        """Return the first candidate that predicts as well as any, until they get ever worse."""
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

        Weaker ones are tried as long as they predict the branches held out better; if the first
        does not, stronger ones are.
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
        """Return the forces of the bounds with all samples."""
        self.misfits(penalties)
        return self._whole.solve(penalties, self._forces[penalties][0])[2]

    def nothing_more_predicts(self, penalties: Penalties) -> bool:
        """Tell whether a line, or nothing beside what is given, predicts as well as a density."""
        nothing = np.zeros(self._whole.about.size)
        misfits = np.array([
            self._unseen_misfit(
                unseen, nothing if self._whole.about.any() else fitted.solve_line()[0])
            for fitted, unseen in zip(self._fitted, self._unseen, strict=True)
        ])
        return self._as_well(misfits, penalties)

    def _unseen_misfit(self, unseen: Equations, unknowns: FloatArray) -> float:
        """Sum of the squared errors of a fold.

        Offsets and transients of the start are no part of the hysteresis: they are those of all
        samples. A transient may lie in one fold alone, and the others tell nothing of it.
        """
        return unseen.misfit(unknowns, self._whole.beside(unknowns))

    def _as_well(self, misfits: FloatArray, least: Penalties) -> bool:
        best = self.misfits(least)
        worse = (misfits - best) / self._counts
        error = float(np.std(worse) / np.sqrt(max(worse.size - 1, 1)))
        chance = np.sqrt(2.0 / self._counts.sum()) * best.sum() / self._counts.sum()
        most = MOST_ABOVE_THE_LEAST * best.sum() / self._counts.sum()
        # Of exact data, the misfits are rounding, of either sign.
        return float(np.mean(worse)) <= max(min(error, most), chance, 0.0)
