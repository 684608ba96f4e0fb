# SPDX-License-Identifier: BSD-3-Clause
"""Probabilities of what a model lacks, from what each alternative leaves on held-out data.

The evidence of an alternative is that of Gaussian errors of unknown variance in each recording r,
with what its fitted numbers cost (`model_weights.occam_penalty`):

    ln p = - sum_r n_r / 2 ln(m_r + l_r^2 + w_r^2) - penalty

Here m_r is the mean square left on held-out stretches, n_r how many of its samples err
independently, l_r the accuracy that a good model has, and w_r what this model is known to be wrong
by: an error of the model may look like any effect. The errors of a good model are alike within a
stretch, so that l_r^2 counts as often as a stretch has independent samples: what an effect explains
of them counts once for each stretch, however many rows show it.

How far errors of a model speak for an alternative shows in how much the ratio of likelihoods
depends on which stretches are held out: the probabilities are means over a Bayesian bootstrap of
the stretches (pseudo-BMA+: Yao, Vehtari, Simpson and Gelman, Using stacking to average Bayesian
predictive distributions, Bayesian Analysis 13, 2018). What is not on the list, `something_else`,
leaves what passes for noise in the new recordings.

An alternative may also leave what the model is known to be wrong by. That is known from other
recordings, and so only up to a factor of logarithmic normal distribution, over which the evidence
against the alternative is averaged: a rest that is a little larger is no sign of another cause.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp, softmax

from piezo_common.arrays import FloatArray
from piezo_identification.fitting.model_weights import HeldOut, occam_penalty

NONE, SOMETHING_ELSE = "none", "something_else"


@dataclass(frozen=True)
class ProbabilitySettings:
    """The model of probability.

    Attributes
    ----------
    something_else : float
        Prior probability of what is not on the list, over that of one of the alternatives.
    carried_over : float
        Standard deviation of the logarithm of what a model is wrong by in one recording, over what
        it is wrong by in another.
    most_wrong : float
        Part of the RMS motion that a model may be known to be wrong by at most: where it is wrong
        by more, it lacks something, and that it is known is no explanation.
    believed : float
        Probability of something else from which a recording is unexplained.
    most_effective : float
        Samples of a recording that count as independent at most: the noise of a stage is no more
        stationary than that.
    """

    something_else: float = 0.05
    carried_over: float = 0.3
    most_wrong: float = 1e-3
    believed: float = 0.5
    most_effective: float = 1000.0


SETTINGS = ProbabilitySettings()

DRAWS = 4000
"""So many draws of the bootstrap determine a probability near 0.95 to 0.003."""
SEED = 0
NODES = 60
"""The quadrature over a normal distribution has so many."""
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
    counted = sum(min(part.independent, SETTINGS.most_effective) for part in held_out)
    rows = float(sum(part.left_um.size for part in held_out))
    return (occam_penalty(covariance, widths, rows, counted)
            + occam_penalty(None, np.zeros(recurrence_count), rows, counted))


def logarithms_of_evidence(alternatives: Sequence[Evidence], least_um: ArrayLike) -> FloatArray:
    """Return the logarithm of the evidence of each alternative.

    Parameters
    ----------
    least_um : (R,) array
        Accuracy of a good model in each recording.

    Returns
    -------
    (n,) array
    """
    left = np.array([alternative.mean_square_um2 for alternative in alternatives])
    squares = left + _accuracy_um2(alternatives, least_um)
    penalties = np.array([alternative.penalty for alternative in alternatives])
    return -0.5 * np.log(squares) @ _samples(alternatives) - penalties


def listed_probabilities(alternatives: Sequence[Evidence], least_um: ArrayLike,
                         wrong_um: ArrayLike = 0.0) -> FloatArray:
    """Return the probability of each alternative, as if there were no others, (n,).

    Parameters
    ----------
    least_um : (R,) array
        Accuracy of a good model in each recording.
    wrong_um : (R',) array
        By how much the model is known to be wrong in each of the new recordings, which come first,
        RMS.
    """
    random = np.random.default_rng(SEED)
    squares_um2 = _accuracy_um2(alternatives, least_um)
    squares_um2[: np.size(wrong_um)] += np.square(np.asarray(wrong_um))
    logarithms = np.zeros((DRAWS, len(alternatives)))
    logarithms -= [each.penalty for each in alternatives]
    for number, (square_um2, samples) in enumerate(
            zip(squares_um2, _samples(alternatives), strict=True)):
        of_recording = [each.held_out[number] for each in alternatives]
        numbers = np.unique(np.concatenate([part.stretch for part in of_recording]))
        weights = random.dirichlet(np.ones(numbers.size), DRAWS)
        for index, part in enumerate(of_recording):
            places = np.searchsorted(numbers, part.stretch)
            squares = weights @ np.bincount(places, part.left_um**2, numbers.size)
            counts = weights @ np.bincount(places, minlength=numbers.size)
            logarithms[:, index] -= 0.5 * samples * np.log(squares / counts + square_um2)
    return np.asarray(softmax(logarithms, axis=1).mean(axis=0))


def _samples(alternatives: Sequence[Evidence]) -> FloatArray:
    """Return how many held-out samples of each recording count, beside the best, (R,)."""
    independent = [[part.independent for part in each.held_out] for each in alternatives]
    return np.minimum(np.max(independent, axis=0), SETTINGS.most_effective)


def _accuracy_um2(alternatives: Sequence[Evidence], least_um: ArrayLike) -> FloatArray:
    """Return the square of the accuracy of a good model, whose errors are alike in a stretch."""
    stretches = [np.unique(part.stretch).size for part in alternatives[0].held_out]
    return np.square(np.asarray(least_um)) * np.maximum(1.0, _samples(alternatives) / stretches)


def probabilities(alternatives: Sequence[Evidence], least_um: ArrayLike, passing_um: ArrayLike,
                  wrong_um: ArrayLike = 0.0) -> dict[str, float]:
    """Return the probability of each set of effects, of none, and of something else.

    Parameters
    ----------
    alternatives : sequence of Evidence
        Alternatives of the same label share their probability.
    least_um : (R,) array
        See `listed_probabilities`.
    passing_um : (R',) array
        What passes for noise in each of the new recordings, which come first.
    wrong_um : (R',) array
        By how much the model is known to be wrong in each of them, RMS.

    Returns
    -------
    dict of str to float
        The largest first; they sum to one.
    """
    passing, least = np.square(np.asarray(passing_um)), np.square(np.asarray(least_um))
    new = passing.size
    wrong_um = np.broadcast_to(np.asarray(wrong_um), new)
    listed = listed_probabilities(alternatives, least_um, wrong_um)
    best = int(np.argmax(listed))
    squares = np.array(alternatives[best].mean_square_um2[:new]) + least[:new]
    gain = gain_of_noise(squares, _samples(alternatives)[:new], passing, np.square(wrong_um))
    # Its odds to the best alternative are those of the prior and of the evidence.
    other = np.exp(min(gain, MOST_GAIN)) * SETTINGS.something_else * listed[best]
    shares = np.append(listed, other) / (1.0 + other)
    summed: dict[str, float] = {}
    labels = [*(each.label for each in alternatives), SOMETHING_ELSE]
    for label, share in zip(labels, shares, strict=True):
        summed[label] = summed.get(label, 0.0) + float(share)
    return dict(sorted(summed.items(), key=lambda entry: -entry[1]))


def gain_of_noise(squares: FloatArray, samples: FloatArray, passing: FloatArray,
                  wrong: FloatArray) -> float:
    """Return the evidence for something that would leave no more than passes for noise.

    It is that against the best alternative, averaged over how much the model may be wrong by.

    Parameters
    ----------
    squares : (R,) array
        Mean squares that the best alternative leaves, in um^2.
    samples : (R,) array
        Independent samples of each recording.
    passing, wrong : (R,) array
        Mean squares that pass for noise, and that the model is known to be wrong by, in um^2.
    """
    sizes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    may_be = passing + wrong * np.exp(2.0 * SETTINGS.carried_over * sizes)[:, None]
    against = -0.5 * np.maximum(0.0, np.log(squares / may_be)) @ samples
    return float(logsumexp(np.log(weights)) - logsumexp(against, b=weights))
