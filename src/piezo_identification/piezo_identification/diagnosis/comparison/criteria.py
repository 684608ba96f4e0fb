# SPDX-License-Identifier: BSD-3-Clause
"""Criteria for whether sets of effects are better than, different from, or good enough as others.

The Akaike and Bayesian information criteria are not used, because both assume independent samples.
Instead, fits are compared on held-out data, with a penalty for every fitted parameter.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from piezo_identification.conditioning.row_alignment import SIGNIFICANT
from piezo_identification.fitting.regression import Fit, Regression


def mean_square(regression: Regression, fit: Fit) -> float:
    """Return the mean square residual of a fit on the validation set, in tolerances."""
    return float(np.mean(fit.residual[regression.validation] ** 2))


def lack_of_fit(regression: Regression, fit: Fit) -> float:
    """Return the mean square residual beyond the noise on the validation set, in tolerances."""
    return max(0.0, mean_square(regression, fit) - noise(regression) ** 2)


def noise(regression: Regression) -> float:
    """Return the RMS of the sensor noise on the validation set, in tolerances."""
    return float(np.sqrt(np.mean(regression.noise_of_rows()[regression.validation] ** 2)))


def significance(regression: Regression, before: Fit, after: Fit) -> float:
    """Return by how many standard deviations the second fit is better on the validation set.

    The difference of the predictions is correlated with the residual of the first fit. The products
    are summed within each stretch, so that errors with long correlation count as one.
    """
    rows = regression.validation
    change = before.residual[rows] - after.residual[rows]
    stretch = regression.dataset.stretch[rows]
    signal = np.bincount(stretch, before.residual[rows] * change)
    chance = np.bincount(stretch, after.residual[rows] * change)
    # The noise remains even with a perfect fit.
    least = np.mean(after.residual[rows] ** 2) * np.sum(change**2)
    spread = np.sqrt(max(np.sum(chance**2), least))
    return float(np.sum(signal) / spread) if spread > 0.0 else 0.0


def visible_part(regression: Regression, before: Fit, after: Fit) -> float:
    """Return the part (0 to 1) of what effects contribute that the regressors cannot explain."""
    contribution = before.difference - after.difference
    contribution = contribution - contribution[regression.estimation].mean()
    whole = float(np.linalg.norm(contribution[regression.estimation]))
    return float(np.linalg.norm(regression.remainder(contribution))) / max(whole, 1e-300)


def contribution_rms(regression: Regression, before: Fit, after: Fit) -> float:
    """Return the RMS contribution of effects to validation rows, without means, in tolerances."""
    squares, count = 0.0, 0
    for mask in regression.dataset.masks():
        added = (before.difference - after.difference)[mask & regression.validation]
        squares, count = squares + np.sum((added - added.mean()) ** 2), count + added.size
    return float(np.sqrt(squares / count))


def distance(regression: Regression, before: Fit, after: Fit) -> float:
    """Return the RMS difference of two predictions of the validation set, in tolerances."""
    rows = regression.validation
    return float(np.sqrt(np.mean((before.residual[rows] - after.residual[rows]) ** 2)))


@dataclass(frozen=True)
class Criteria:
    """Limits of the comparison of sets of effects."""

    noise: float = 0.8
    """Size of the residual beyond the noise, in tolerances, below which it counts as noise."""
    overwhelming: float = 0.36
    """Ratio of the mean squares on held-out data below which the gain is convincing by itself. If
    one event, such as a jump, provides all evidence, statistical significance does not apply."""
    significant: float = 5.0
    """Significance required of a gain, in standard deviations; each round has a dozen
    candidates."""
    noticeable: float = 0.25
    """Smallest contribution of an effect that is named, in tolerances."""
    noticeable_share: float = 0.02
    """The same relative to the error of the model without effects, because effects are not known
    more accurately."""
    visible: float = 0.1
    """Smallest part of a contribution that other parameters of the model cannot imitate."""
    penalty: float = 10.0
    """Squared tolerances by which a fitted parameter must reduce the sum on held-out data."""
    clearly_fewer: int = 2
    """Number of parameters by which a set must be smaller to precede a slightly better one."""
    alternatives: int = 4
    """Number of sets of equal size that enter the next round."""
    worst_alternative: float = 1.5
    """Largest residual of these sets, relative to that of the best one."""


CRITERIA = Criteria()

GUESS = 0.5
"""Largest part of the power of the lack of fit that may remain before the effects found are
regarded as guesses."""


def is_noise(regression: Regression, fit: Fit) -> bool:
    """Return whether the residual of a fit is small enough to be regarded as noise."""
    return lack_of_fit(regression, fit) <= CRITERIA.noise**2


def is_convincing(regression: Regression, start: Fit, before: Fit, after: Fit) -> bool:
    """Return whether a fit is better than another both significantly and noticeably.

    `start` is the fit without any effect.
    """
    residual = np.sqrt(mean_square(regression, start))
    least = max(CRITERIA.noticeable, CRITERIA.noticeable_share * residual)
    square_before, square_after = (mean_square(regression, fit) for fit in (before, after))
    return bool(
        (significance(regression, before, after) > CRITERIA.significant
         or square_after < CRITERIA.overwhelming * square_before)
        and distance(regression, before, after) > least
        and square_after < square_before
    )


def is_indistinguishable(regression: Regression, best: Fit, other: Fit,
                         distinguished: float = SIGNIFICANT) -> bool:
    """Return whether the data cannot distinguish a set of effects from the best one.

    The residual of the best set beyond the noise shows the accuracy of its prediction: sets that
    differ by less, or by less than `distinguished` standard deviations, cannot be distinguished.
    """
    return bool(distance(regression, other, best) < _remaining(regression, best)
                or significance(regression, other, best) < distinguished)


def score(regression: Regression, fit: Fit | None) -> float:
    """Return the sum of squares on held-out data plus a penalty for every fitted parameter."""
    if fit is None:
        return np.inf
    square = mean_square(regression, fit)
    # If a lack of fit remains, a parameter must reduce the sum in proportion.
    return (np.count_nonzero(regression.validation) * square
            + CRITERIA.penalty * fit.parameter_count * max(1.0, square))


def alternatives(regression: Regression, fits: Sequence[Fit]) -> list[Fit]:
    """Return the first few fits, without those with a much larger residual than the first."""
    return [
        fit for fit in fits[:CRITERIA.alternatives]
        if _remaining(regression, fit)
        < CRITERIA.worst_alternative * _remaining(regression, fits[0])
    ]


def simplest_first(regression: Regression, fits: list[Fit]) -> list[Fit]:
    """Put a set with clearly fewer parameters first if it is equivalent to the best one.

    The gain from more parameters must be as significant as the gain from an effect.
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


def _remaining(regression: Regression, fit: Fit) -> float:
    """Return the RMS residual beyond the noise on held-out data, in tolerances."""
    return np.sqrt(max(CRITERIA.noticeable**2, lack_of_fit(regression, fit)))


class Reason(StrEnum):
    """Kind of reason, for use by programs; users read the sentence."""

    NOT_EXCITED = "not excited"
    IMPOSSIBLE = "impossible"
    SAME_AS_OTHER_PARAMETERS = "same as other parameters"
    LIKE_ANOTHER = "like another effect"
    WORSE_ON_HELD_OUT = "worse on held-out data"


@dataclass(frozen=True)
class Undecided:
    """A reason with its sentence."""

    reason: Reason

    sentence: str
    """Sentence without its end."""


OTHER_PARAMETERS = Undecided(Reason.SAME_AS_OTHER_PARAMETERS,
                             "here a model with slightly other parameters does the same")
