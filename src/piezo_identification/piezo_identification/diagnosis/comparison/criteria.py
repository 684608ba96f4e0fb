# SPDX-License-Identifier: BSD-3-Clause
"""When a set of effects is better than another, when two cannot be told apart, when it is enough.

No Akaike or Bayesian information criterion is used: both take samples as independent. Here fits
are compared on held-out data, with a penalty for every fitted number.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezo_identification.diagnosis.comparison.measures_of_fits import (
    distance,
    lack_of_fit,
    mean_square,
    significance,
)
from piezo_identification.fitting.regression import Fit, Regression


@dataclass(frozen=True)
class Criteria:
    """Limits of the comparison of sets of effects.

    Attributes
    ----------
    noise : float
        Size of what is left beyond the noise, in tolerances, below which it passes for noise.
    overwhelming : float
        Part below which the mean square on held-out data convinces by itself: where one event, such
        as a jump, holds all of the evidence, there is no significance by numbers.
    significant : float
        Standard deviations that a gain must have; a dozen candidates try in every round.
    noticeable : float
        Size of a contribution, in tolerances, below which no effect is named.
    beside : float
        The same as a part of all that the model did not explain: an effect is not known any better.
    visible : float
        Part of a contribution that other parameters of the model must leave for it to be seen.
    told_apart : float
        Standard deviations by which one set must be better than another to be told from it.
    penalty : float
        Tolerances squared by which a fitted number must lower the sum on held-out data.
    clearly_fewer : int
        Fitted numbers by which a set must be smaller to come before one that is slightly better.
    alternatives : int
        Sets of one size that go on to the next round.
    worst_alternative : float
        How many times as much as the best of them they may leave.
    """

    noise: float = 0.8
    overwhelming: float = 0.36
    significant: float = 5.0
    noticeable: float = 0.25
    beside: float = 0.02
    visible: float = 0.1
    told_apart: float = 3.0
    penalty: float = 10.0
    clearly_fewer: int = 2
    alternatives: int = 4
    worst_alternative: float = 1.5


CRITERIA = Criteria()


def is_noise(regression: Regression, fit: Fit) -> bool:
    """Return whether a fit leaves so little that the diagnosis takes it for noise."""
    return lack_of_fit(regression, fit) <= CRITERIA.noise**2


def is_convincing(regression: Regression, start: Fit, before: Fit, after: Fit) -> bool:
    """Return whether a fit is better than another both significantly and noticeably.

    Parameters
    ----------
    start : Fit
        Without any effect.
    before, after : Fit
        The smaller and the larger set.
    """
    least = max(CRITERIA.noticeable, CRITERIA.beside * np.sqrt(mean_square(regression, start)))
    square_before, square_after = (mean_square(regression, fit) for fit in (before, after))
    return bool(
        (significance(regression, before, after) > CRITERIA.significant
         or square_after < CRITERIA.overwhelming * square_before)
        and distance(regression, before, after) > least
        and square_after < square_before
    )


def is_indistinguishable(regression: Regression, best: Fit, other: Fit,
                         told_apart: float = CRITERIA.told_apart) -> bool:
    """Return whether the data cannot tell a set of effects from the best one.

    What the best set leaves beyond the noise is how far its prediction can be trusted: sets that
    differ by less cannot be told apart.

    Parameters
    ----------
    told_apart : float
        Standard deviations by which the best set must be better.
    """
    return bool(distance(regression, other, best) < _left(regression, best)
                or significance(regression, other, best) < told_apart)


def score(regression: Regression, fit: Fit | None) -> float:
    """Return the sum of squares on held-out data with a penalty for every fitted number."""
    if fit is None:
        return np.inf
    square = mean_square(regression, fit)
    # Where a lack of fit is left, a number must lower the sum in proportion.
    return (np.count_nonzero(regression.validation) * square
            + CRITERIA.penalty * fit.parameter_count * max(1.0, square))


def alternatives(regression: Regression, fits: Sequence[Fit]) -> list[Fit]:
    """Return the first of some fits, and of the next those that leave not much more."""
    return [
        fit for fit in fits[:CRITERIA.alternatives]
        if _left(regression, fit) < CRITERIA.worst_alternative * _left(regression, fits[0])
    ]


def simplest_first(regression: Regression, fits: list[Fit]) -> list[Fit]:
    """Put the set first that is like the best one with clearly fewer numbers, if there is one.

    What more numbers gain must be as sure as what an effect gains.
    """
    if not fits:
        return fits
    first = min(
        (fit for fit in fits
         if is_indistinguishable(regression, fits[0], fit, CRITERIA.significant)),
        key=lambda fit: fit.parameter_count,
    )
    if first.parameter_count > fits[0].parameter_count - CRITERIA.clearly_fewer:
        return fits
    return sorted(fits, key=lambda fit: fit is not first)


def _left(regression: Regression, fit: Fit) -> float:
    """Return the RMS of what is left beyond the noise on held-out data, in tolerances."""
    return np.sqrt(max(CRITERIA.noticeable**2, lack_of_fit(regression, fit)))
