# SPDX-License-Identifier: BSD-3-Clause
"""What the models that compete come to: probabilities, and the alternative that is believed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.diagnosis.comparison.criteria import CRITERIA, is_noise
from piezo_identification.diagnosis.comparison.selection import Selection
from piezo_identification.diagnosis.comparison.undecided import in_place_of_the_found
from piezo_identification.diagnosis.joint.alternatives import (
    Alternative,
    accuracies_um,
    compete,
    independent_samples,
    most_probable,
    settled,
)
from piezo_identification.diagnosis.joint.joint_fit import JointProblem, correlated_scale
from piezo_identification.diagnosis.joint.probabilities import (
    NONE,
    SOMETHING_ELSE,
    Evidence,
    probabilities,
)
from piezo_identification.diagnosis.residual.dataset import Dataset
from piezo_identification.diagnosis.residual.regression import (
    SETTINGS,
    Fit,
    Regression,
    reweighted,
)
from piezo_identification.diagnosis.residual.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects import known_effects
from piezo_recorder.reading.recording import Recording

LIKELY = 0.05
"""Part of the largest probability from which another set cannot be told from the best."""


@dataclass(frozen=True, eq=False)
class Competition:
    """Probabilities of the models that competed, and the one that is believed.

    Attributes
    ----------
    probabilities : dict of str to float
        Of each set of effects that matters, of `none` and of `something_else`; they sum to one.
    best : Alternative or None
        The model that is believed; None where the recordings of the identification were not asked.
    """

    probabilities: dict[str, float]
    best: Alternative | None = None

    def indistinguishable(self) -> dict[str, str]:
        """Return likely effects of others, and the one of the best that each replaces."""
        if self.best is None:
            return {}
        found: dict[str, str] = {}
        own = set(self.best.names)
        least = LIKELY * self.probabilities["+".join(self.best.names) or NONE]
        for label, share in self.probabilities.items():
            names = set(label.split("+")) - {NONE, SOMETHING_ELSE}
            if share >= least and names - own and own - names:
                found |= dict.fromkeys(names - own, min(own - names))
        return found


def compare_models(model: StageModel, new: Sequence[Recording], old: Sequence[Recording],
                   selection: Selection, stated_um: float,
                   progress: Callable[[str, float], None]) -> Competition:
    """Let models compete on all recordings, or the sets of effects on the new ones alone.

    The recordings of the identification are not asked where the model leaves nothing but noise.

    Parameters
    ----------
    model : StageModel
    new, old : sequence of Recording
        To be diagnosed, and of the identification; with the sign of the model, and their outliers
        marked.
    selection : Selection
        Of effects that explain the new recordings alone.
    stated_um : float
        By how much the model is known to be wrong, RMS.
    progress : callable
        Called with (what is done, fraction).

    Returns
    -------
    Competition
    """
    if not old or is_noise(selection.regression, selection.start):
        return Competition(_of_new_recordings(selection, stated_um))
    problem, none = settled(JointProblem(model, new, old), progress)
    alternatives = compete(problem, none, [selection.end.effects], progress)
    best = most_probable(problem, alternatives)
    noise_um = np.array(problem.noise.noise_um)
    least_um = accuracies_um(problem)
    ranges_um = np.array([np.ptp(part.measured_um) for part in problem.dataset.simulated])
    count = len(new)
    # What the best leaves of the recordings of the identification: so wrong is it known to be.
    beyond = np.maximum(0.0, np.array(best.mean_square_um2) - noise_um**2) / ranges_um**2
    wrong_um = np.sqrt(np.mean(beyond[count:])) * ranges_um[:count]
    return Competition(
        probabilities([each.evidence for each in alternatives],
                      independent_samples(alternatives), least_um,
                      _passing_um(noise_um[:count], least_um[:count], wrong_um)), best)


def _passing_um(noise_um: FloatArray, least_um: FloatArray, wrong_um: FloatArray) -> FloatArray:
    """Return what passes for noise and what a model is known to be wrong by, RMS."""
    tolerance_um = np.hypot(noise_um, least_um)
    return np.sqrt(tolerance_um**2 + (CRITERIA.noise * tolerance_um) ** 2 + wrong_um**2)


def _of_new_recordings(selection: Selection, stated_um: float) -> dict[str, float]:
    """Return the probabilities of the sets that the new recordings alone do not exclude."""
    regression = selection.regression
    fits = [selection.start, selection.end, *selection.alternatives]
    fits = fits if selection.end.effects else fits[:1]
    evidence, effective = [], []
    for fit in fits:
        squares, samples = _held_out(regression, fit)
        label = "+".join(sorted(effect.name for effect in fit.effects)) or NONE
        evidence.append(Evidence(label, squares, fit.parameter_count))
        effective.append(samples)
    least_um = np.array([SETTINGS.model_tolerance * np.ptp(part.measured_um)
                         for part in regression.dataset.simulated])
    wrong_um = np.full(least_um.size, stated_um if selection.end.effects else 0.0)
    return probabilities(
        evidence, np.max(effective, axis=0), least_um,
        _passing_um(np.array(regression.noise.noise_um), least_um, wrong_um))


def _held_out(regression: Regression, fit: Fit) -> tuple[tuple[float, ...], list[float]]:
    """Return the mean square left of each recording, and how many samples err independently."""
    left_um = fit.residual * regression.tolerance_um
    squares, samples = [], []
    for mask in regression.dataset.masks():
        left = left_um[mask & regression.validation]
        squares.append(float(np.mean(left**2)))
        samples.append(left.size * squares[-1] / correlated_scale(left) ** 2)
    return tuple(squares), samples


def beside_alternative(selection: Selection, competition: Competition,
                       alternative: Alternative) -> Selection:
    """Return a selection of the effects of an alternative that were there all along.

    Parameters
    ----------
    selection : Selection
        Of effects beside the model as it was given.
    competition : Competition
    alternative : Alternative
        Its best.

    Returns
    -------
    Selection
        Beside the alternative's model.
    """
    effects, count = alternative.fit.effects, len(alternative.names)
    own, added = effects[: len(effects) - count], effects[len(effects) - count :]
    model = replace(alternative.fit.regression.dataset.model, effects=own)
    before = selection.regression
    moved = replace(before, dataset=_with_model(before.dataset, model))
    regression = reweighted(moved, added)
    covariance = alternative.fit.covariance
    if covariance is not None:
        numbers = regression.fit(added).parameter_count
        covariance = covariance[len(covariance) - numbers :, len(covariance) - numbers :]
    end = regression.fit(added, covariance)
    alike = in_place_of_the_found(regression, list(known_effects().values()), end)
    return replace(selection, regression=regression, end=end,
                   indistinguishable=alike | competition.indistinguishable())


def _with_model(dataset: Dataset, model: StageModel) -> Dataset:
    """Simulate another model on the same rows."""
    return replace(dataset, model=model, simulated=tuple(
        SimulatedRecording(model, recording, part.past_v)
        for recording, part in zip(dataset.recordings, dataset.simulated, strict=True)))
