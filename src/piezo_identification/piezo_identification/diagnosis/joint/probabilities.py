# SPDX-License-Identifier: BSD-3-Clause
"""Probabilities of what a model lacks, from what each alternative leaves on held-out data.

The evidence of an alternative is that of the noise and of what the model may be wrong by
(`expected_errors`), with what its fitted numbers cost (`model_weights.occam_penalty`). Every
further cause has the same prior odds, on the list or not. So an effect that explains what a model
may be wrong by anyway is not named, alone or beside another.

How far errors of a model speak for an alternative also shows in how much the ratio of likelihoods
depends on which stretches are held out: the probabilities are means over a Bayesian bootstrap of
the stretches (pseudo-BMA+: Yao, Vehtari, Simpson and Gelman, Using stacking to average Bayesian
predictive distributions, Bayesian Analysis 13, 2018). What is not on the list, `something_else`,
leaves what passes for noise in the new recordings.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from piezo_common.arrays import FloatArray
from piezo_identification.diagnosis.joint.expected_errors import SETTINGS as ERRORS
from piezo_identification.diagnosis.joint.expected_errors import ExpectedErrors
from piezo_identification.fitting.model_weights import HeldOut, occam_penalty

NONE, SOMETHING_ELSE = "none", "something_else"


@dataclass(frozen=True)
class ProbabilitySettings:
    """The model of probability.

    Attributes
    ----------
    one_cause : float
        Prior odds of one more cause, whether it is on the list or not: there are twenty kinds.
    believed : float
        Probability of something else from which a recording is unexplained.
    most_effective : float
        Samples of a recording that count as independent at most: the noise of a stage is no more
        stationary than that.
    """

    one_cause: float = 0.05
    believed: float = 0.5
    most_effective: float = 1000.0


SETTINGS = ProbabilitySettings()

DRAWS = 4000
"""So many draws of the bootstrap determine a probability near 0.95 to 0.003."""
SEED = 0
MOST_GAIN = 500.0
"""A logarithm of odds that leaves nothing to doubt, and whose exponential is finite."""


@dataclass(frozen=True)
class Evidence:
    """What is known of one alternative.

    Attributes
    ----------
    label : str
        Names of its effects with + between them, or `none`.
    held_out : (R,) tuple of HeldOut
        What is left on held-out stretches of each recording.
    penalty : float
        What the fitted numbers of the effects cost; see `model_weights.occam_penalty`.
    """

    label: str
    held_out: tuple[HeldOut, ...]
    penalty: float

    @property
    def mean_square_um2(self) -> tuple[float, ...]:
        """Return the mean square that is left of each recording."""
        return tuple(part.mean_square_um2 for part in self.held_out)

    @property
    def cost(self) -> float:
        """Return what its numbers and the prior odds of its effects take from the evidence."""
        causes = 0 if self.label == NONE else self.label.count("+") + 1
        return self.penalty - causes * float(np.log(SETTINGS.one_cause))


def penalty_of(held_out: Sequence[HeldOut], covariance: FloatArray | None, widths: FloatArray,
               recurrence_count: int = 0) -> float:
    """Return what fitted numbers cost, with so many errors as the evidence counts.

    Parameters
    ----------
    held_out : (R,) sequence of HeldOut
    covariance, widths
        Of `model_weights.occam_penalty`.
    recurrence_count : int
        Further numbers, which each recording of the identification has of its own; the recordings
        determine them, and each costs the most.
    """
    counted = sum(min(part.independent, ERRORS.independent) for part in held_out)
    rows = float(sum(part.left_um.size for part in held_out))
    return (occam_penalty(covariance, widths, rows, counted)
            + occam_penalty(None, np.zeros(recurrence_count), rows, counted))


def logarithms_of_evidence(alternatives: Sequence[Evidence],
                           expected: ExpectedErrors) -> FloatArray:
    """Return the logarithm of the evidence of each alternative, (n,)."""
    left = np.array([alternative.mean_square_um2 for alternative in alternatives])
    return (expected.logarithms(left, _samples(alternatives))
            - [alternative.cost for alternative in alternatives])


def listed_probabilities(alternatives: Sequence[Evidence], expected: ExpectedErrors) -> FloatArray:
    """Return the probability of each alternative, as if there were no others, (n,)."""
    random = np.random.default_rng(SEED)
    left = np.empty((DRAWS, len(alternatives), expected.noise_um.size))
    for number in range(expected.noise_um.size):
        of_recording = [each.held_out[number] for each in alternatives]
        numbers = np.unique(np.concatenate([part.stretch for part in of_recording]))
        weights = random.dirichlet(np.ones(numbers.size), DRAWS)
        for index, part in enumerate(of_recording):
            places = np.searchsorted(numbers, part.stretch)
            squares = weights @ np.bincount(places, part.left_um**2, numbers.size)
            left[:, index, number] = squares / (
                weights @ np.bincount(places, minlength=numbers.size))
    logarithms = expected.logarithms(left, _samples(alternatives))
    return np.asarray(softmax(
        logarithms - [each.cost for each in alternatives], axis=1).mean(axis=0))


def _samples(alternatives: Sequence[Evidence]) -> FloatArray:
    """Return how many held-out samples of each recording count, beside the best, (R,)."""
    independent = [[part.independent for part in each.held_out] for each in alternatives]
    return np.minimum(np.max(independent, axis=0), SETTINGS.most_effective)


def probabilities(alternatives: Sequence[Evidence], expected: ExpectedErrors,
                  new_count: int) -> dict[str, float]:
    """Return the probability of each set of effects, of none, and of something else.

    Parameters
    ----------
    alternatives : sequence of Evidence
        Alternatives of the same label share their probability.
    new_count : int
        So many recordings, the first ones, are diagnosed.

    Returns
    -------
    dict of str to float
        The largest first; they sum to one.
    """
    listed = listed_probabilities(alternatives, expected)
    best = int(np.argmax(listed))
    other = odds_of_something_else(
        np.array(alternatives[best].mean_square_um2[:new_count]),
        _samples(alternatives)[:new_count], expected.of_first(new_count)) * listed[best]
    shares = np.append(listed, other) / (1.0 + other)
    summed: dict[str, float] = {}
    labels = [*(each.label for each in alternatives), SOMETHING_ELSE]
    for label, share in zip(labels, shares, strict=True):
        summed[label] = summed.get(label, 0.0) + float(share)
    return dict(sorted(summed.items(), key=lambda entry: -entry[1]))


def odds_of_something_else(left_um2: FloatArray, samples: FloatArray,
                           expected: ExpectedErrors) -> float:
    """Return the odds of something that would leave no more than passes for noise.

    They are those to an alternative.

    Parameters
    ----------
    left_um2 : (R,) array
        Mean squares that the alternative leaves.
    samples : (R,) array
        Independent samples of each recording.
    """
    return SETTINGS.one_cause * float(
        np.exp(min(-expected.logarithm_of_chance(left_um2, samples), MOST_GAIN)))
