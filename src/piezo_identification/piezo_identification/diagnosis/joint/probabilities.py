# SPDX-License-Identifier: BSD-3-Clause
"""Probabilities of what a model lacks, from the errors of each alternative on held-out data.

The evidence of an alternative includes the noise and the possible errors of the model
(see below), and the cost of its fitted parameters (`model_weights.occam_penalty`). Every
additional cause has the same prior odds, whether it is on the list or not. An effect that explains
no more than the possible errors of the model is therefore not named, alone or with another.

The reliability of the evidence also depends on which stretches are held out. The probabilities are
therefore means over a Bayesian bootstrap of the stretches (pseudo-BMA+: Yao, Vehtari, Simpson and
Gelman, Using stacking to average Bayesian predictive distributions, Bayesian Analysis 13, 2018). A
cause that is not on the list, `something_else`, would reduce the residual of the new recordings to
noise.

Errors of a model have a long correlation: at most k_r of them are independent in recording r. They
are at least as large as those of a good model, l_r, and as the known error of this model, w_r. They
are larger by a factor f, the logarithm of which has a half-normal distribution, and over which the
evidence is averaged. For a mean square m_r with noise of variance s_r^2 the evidence is

    ln p = ln E_f exp(- sum_r k_r / 2 (ln v_r + (m_r - s_r^2) / v_r))
    v_r = f^2 (l_r^2 + w_r^2) + s_r^2 (k_r / n_r + d)

with n_r the number of independent samples, and d the relative error of the variance of the noise.
For a perfect model and known noise, this is the likelihood of white noise.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp, softmax

from piezo_common.arrays import FloatArray
from piezo_identification.diagnosis.comparison.criteria import CRITERIA
from piezo_identification.fitting.dataset import Dataset
from piezo_identification.fitting.evidence import INDEPENDENT
from piezo_identification.fitting.model_weights import HeldOut, occam_penalty
from piezo_identification.fitting.regression import accuracies_um
from piezo_models.effects import Effect

DEVIATIONS = np.linspace(0.0, 4.0, 41)
"""Values of the logarithm of the factor, relative to its width, at which the evidence is summed."""

WEIGHTS = -0.5 * DEVIATIONS**2 - logsumexp(-0.5 * DEVIATIONS**2)
"""Logarithms of their probabilities."""

NONE, SOMETHING_ELSE = "none", "something_else"

ONE_CAUSE = 0.05
"""Prior odds of one more cause, whether it is on the list or not: there are twenty kinds."""

BELIEVED = 0.5
"""Probability of something else above which a recording is unexplained."""

DRAWS = 4000
"""Number of draws of the bootstrap, which determine a probability near 0.95 to 0.003."""

LISTED, ALTERNATIVE = 1e-3, 0.01
"""Smallest probability of a set of effects that is listed, and that is an alternative to others."""

MOST_GAIN = 500.0
"""Logarithm of odds that are practically certain, with a finite exponential."""


@dataclass(frozen=True)
class ErrorSettings:
    """Size of the errors of a model."""

    carried_spread: float = 0.6
    """RMS of the logarithm of the error of a complete model in another recording, relative to the
    worst of those that it was fitted to. Set on 40 recordings of five drawn stages:
    docs/diagnosis_method.md."""
    independent: float = 10.0
    """Number of independent errors of a model in one recording. Set on the same data: the best of
    the known effects explains a third or half of them."""
    noise_known: float = 0.1
    """Relative error of the variance of the noise. Set on the same data."""
    most_wrong: float = 1e-3
    """Largest known error of a model that is accepted, relative to the RMS motion: a larger error
    shows that the model lacks something."""


SETTINGS = ErrorSettings()

SIZES = np.exp(2.0 * SETTINGS.carried_spread * DEVIATIONS)[:, None]
"""Squares of the factor."""


@dataclass(frozen=True, eq=False)
class ExpectedErrors:
    """Expected RMS residual of each recording with a complete model."""

    noise_um: FloatArray
    """Noise of the sensor, (R,)."""
    model_um: FloatArray
    """Error of the model, (R,)."""
    accuracy_um: FloatArray
    """Accuracy of a good model, (R,)."""

    def of_first(self, count: int) -> "ExpectedErrors":
        """Return the expected errors of the first recordings only."""
        return ExpectedErrors(
            self.noise_um[:count], self.model_um[:count], self.accuracy_um[:count])

    def logarithms(self, squares_um2: FloatArray, samples: FloatArray) -> FloatArray:
        """Return the log-evidence, (...), of mean squares, (..., R), of so many samples, (R,)."""
        count = np.minimum(samples, SETTINGS.independent)
        variance = SIZES * self.model_um**2 + self.noise_um**2 * (
            count / samples + SETTINGS.noise_known)
        beyond = np.maximum(0.0, squares_um2 - self.noise_um**2)
        against = 0.5 * (np.log(variance) @ count + beyond @ (count / variance).T)
        return np.asarray(logsumexp(WEIGHTS - against, axis=-1))

    def logarithm_of_chance(self, squares_um2: FloatArray, samples: FloatArray) -> float:
        """Return the logarithm of the probability of so large a residual; see `logarithms`."""
        passing = (self.noise_um**2 + self.accuracy_um**2) * (1.0 + CRITERIA.noise**2)
        wrong = self.model_um**2 - self.accuracy_um**2
        against = 0.5 * np.maximum(0.0, np.log(
            (squares_um2 + self.accuracy_um**2) / (passing + SIZES * wrong))) @ samples
        return float(logsumexp(WEIGHTS - against))


def expected_errors(dataset: Dataset, noise_um: Sequence[float],
                    stated_um: float) -> ExpectedErrors:
    """Return the expected errors of recordings, with noise (R,), of a complete model."""
    motion_um = np.array([np.std(part.measured_um[part.begin :]) for part in dataset.simulated])
    return errors_of_model(np.array(noise_um), accuracies_um(dataset), motion_um, stated_um)


def errors_of_model(noise_um: FloatArray, accuracy_um: FloatArray, motion_um: FloatArray,
                    stated_um: float | FloatArray) -> ExpectedErrors:
    """Return the expected errors of recordings with an RMS motion, all (R,)."""
    wrong_um = np.minimum(stated_um, SETTINGS.most_wrong * motion_um)
    return ExpectedErrors(noise_um, np.hypot(accuracy_um, wrong_um), accuracy_um)


def label_of(effects: Iterable[Effect]) -> str:
    """Return the names of effects joined by +, or `none`."""
    return "+".join(sorted(effect.name for effect in effects)) or NONE


@dataclass(frozen=True)
class Evidence:
    """Evidence for one alternative."""

    label: str
    """Names of its effects joined by +, or `none`."""
    held_out: tuple[HeldOut, ...]
    """Residuals on held-out stretches of each recording, (R,)."""
    penalty: float
    """Cost of the fitted parameters of the effects."""

    @classmethod
    def weighed(cls, label: str, held_out: Sequence[HeldOut], covariance: FloatArray | None,
                widths: FloatArray, recurrence_count: int = 0) -> "Evidence":
        """Weigh the fitted parameters by the number of errors that the evidence counts.

        For `covariance` and `widths` see `occam_penalty`. There are `recurrence_count` additional
        parameters specific to recordings of the identification. The recordings determine them, and
        each has the largest cost.
        """
        counted = sum(min(part.independent, SETTINGS.independent) for part in held_out)
        rows = float(sum(part.residual_um.size for part in held_out))
        return cls(label, tuple(held_out), (
            occam_penalty(covariance, widths, rows, counted)
            + occam_penalty(None, np.zeros(recurrence_count), rows, counted)))

    @property
    def mean_square_um2(self) -> tuple[float, ...]:
        """Return the mean square residual of each recording."""
        return tuple(part.mean_square_um2 for part in self.held_out)

    @property
    def cost(self) -> float:
        """Return the cost of its parameters plus that of the prior odds of its effects."""
        causes = 0 if self.label == NONE else self.label.count("+") + 1
        return self.penalty - causes * float(np.log(ONE_CAUSE))


def logarithms_of_evidence(alternatives: Sequence[Evidence],
                           expected: ExpectedErrors) -> FloatArray:
    """Return the log-evidence of each alternative, (n,)."""
    squares_um2 = np.array([alternative.mean_square_um2 for alternative in alternatives])
    return (expected.logarithms(squares_um2, _samples(alternatives))
            - [alternative.cost for alternative in alternatives])


def listed_probabilities(alternatives: Sequence[Evidence], expected: ExpectedErrors) -> FloatArray:
    """Return the probability of each alternative, assuming there are no others, (n,)."""
    random = np.random.default_rng(0)
    squares_um2 = np.empty((DRAWS, len(alternatives), expected.noise_um.size))
    for number in range(expected.noise_um.size):
        of_recording = [each.held_out[number] for each in alternatives]
        numbers = np.unique(np.concatenate([part.stretch for part in of_recording]))
        weights = random.dirichlet(np.ones(numbers.size), DRAWS)
        for index, part in enumerate(of_recording):
            places = np.searchsorted(numbers, part.stretch)
            squares = weights @ np.bincount(places, part.residual_um**2, numbers.size)
            squares_um2[:, index, number] = squares / (
                weights @ np.bincount(places, minlength=numbers.size))
    logarithms = expected.logarithms(squares_um2, _samples(alternatives))
    return np.asarray(softmax(
        logarithms - [each.cost for each in alternatives], axis=1).mean(axis=0))


def _samples(alternatives: Sequence[Evidence]) -> FloatArray:
    """Return the number of held-out samples of each recording that count, (R,)."""
    independent = [[part.independent for part in each.held_out] for each in alternatives]
    return np.minimum(np.max(independent, axis=0), INDEPENDENT)


def probabilities(alternatives: Sequence[Evidence], expected: ExpectedErrors,
                  new_count: int) -> dict[str, float]:
    """Return the probability of each set of effects, of none, and of something else.

    They are in descending order, and sum to one. Alternatives of the same label share their
    probability. The first `new_count` recordings are those that are diagnosed.
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


def odds_of_something_else(squares_um2: FloatArray, samples: FloatArray,
                           expected: ExpectedErrors) -> float:
    """Return the odds of an unlisted cause that would reduce the residual to noise.

    The odds are relative to an alternative with these mean squares, (R,), of so many independent
    samples, (R,).
    """
    return ONE_CAUSE * float(
        np.exp(min(-expected.logarithm_of_chance(squares_um2, samples), MOST_GAIN)))
