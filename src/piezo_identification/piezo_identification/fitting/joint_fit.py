# SPDX-License-Identifier: BSD-3-Clause
"""Joint estimation of a model and effects from several recordings, by Levenberg-Marquardt steps."""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.side_by_side import side_by_side
from piezo_identification.fitting.dataset import Dataset, dataset_of
from piezo_identification.fitting.effect_fit import fit_effects
from piezo_identification.fitting.evidence import correlated_scale
from piezo_identification.fitting.free_parameters import (
    free_sensitivities,
    kept_pieces_um,
)
from piezo_identification.fitting.joint_errors import JointErrors, simulated_by
from piezo_identification.fitting.levenberg_marquardt import descend
from piezo_identification.fitting.noise_estimate import NoiseEstimate, estimate_noise
from piezo_identification.fitting.regression import (
    Regression,
    accuracies_um,
    regression_with,
)
from piezo_identification.simulation.past_search import simulated_recording
from piezo_identification.simulation.simulated_recording import SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect, fitted_values
from piezo_recorder.reading.recording import Recording


@dataclass(frozen=True)
class JointSettings:
    """Limits of a joint fit."""

    steps: int = 2
    """Largest number of steps of a fit, each with its own derivatives."""
    worthwhile: float = 0.5
    """Smallest predicted gain of log-evidence for a step; half of it is a factor of 1.3 in a
    probability."""


SETTINGS = JointSettings()


@dataclass(frozen=True, eq=False)
class JointFit:
    """A model and effects that were estimated together."""

    regression: Regression
    """Regression with the model's parameters as estimated together with the effects."""
    effects: tuple[Effect, ...]
    """Effects in all recordings, except those in `later`."""
    later: frozenset[str]
    """Names of the effects that are in the new recordings only."""
    covariance: FloatArray | None = None
    """Covariance of the fitted values of the effects, (p, p)."""
    has_converged: bool = True
    """True if another step would gain too little evidence."""
    changes: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Changes relative to the model of the problem, (m,); see `free_parameters.changed_model`."""
    gain: float = 0.0
    """Log-evidence gained by the last step."""
    against: float = np.inf
    """Minimised function at the result; see `joint_errors.JointErrors.value`."""
    recurrence_count: int = 0
    """Number of parameters of recurring effects specific to recordings of the identification."""
    problem: "JointProblem | None" = field(default=None, repr=False)
    """Problem in which the fit can be continued."""
    columns_of_effects: FloatArray | None = None
    """Derivatives of the displacement by the fitted values of the effects, in um, (r, p)."""

    @property
    def model(self) -> StageModel:
        """Return the present model of the stage, including its effects."""
        model = self.regression.dataset.model
        return replace(model, effects=(*model.effects, *self.effects))

    @property
    def columns(self) -> FloatArray | None:
        """Return the derivatives of the displacement by all fitted parameters, in um.

        The shape is (r, m + p), with the m changes of the model first; None if they are unknown.
        """
        dataset = self.regression.dataset
        return None if self.columns_of_effects is None else np.hstack(
            [dataset.regressors[:, dataset.nuisance_count :], self.columns_of_effects])

    @property
    def count(self) -> int:
        """Return the number of fitted parameters of effects."""
        return self.recurrence_count + sum(
            fitted_values(effect)[0].size for effect in self.effects)


class JointProblem:
    """Recordings, a model from which fits start, and its derivatives.

    The effects of the initial model are fitted together with the others. The new recordings have
    the sign of the model and marked outliers; the old ones are those from which the model was
    identified. The first `undivided` of the new recordings use as many rows each as all others
    together. `simulated` holds the first of the new recordings if they are already simulated. Their
    past, which takes long to find, is then reused.
    """

    steps = SETTINGS.steps

    def __init__(self, model: StageModel, new: Sequence[Recording],
                 old: Sequence[Recording], undivided: int = 0,
                 simulated: Sequence[SimulatedRecording] = ()) -> None:
        self.own, self.new_count = model.effects, len(new)
        self.undivided = undivided
        bare, recordings = replace(model, effects=()), [*new, *old]
        self.dataset = self._dataset_of([
            *(part.with_model(bare) for part in simulated),
            *side_by_side(lambda recording: simulated_recording(bare, recording),
                          recordings[len(simulated) :]),
        ], recordings)
        self.noise = estimate_noise(self.dataset, self.own)
        self.start = self._started()

    def about(self, model: StageModel) -> "JointProblem":
        """Return the same problem with another initial model without effects."""
        problem = copy(self)
        vars(problem).pop("_pieces_um", None)
        problem.dataset = self._dataset_of(
            [part.with_model(model) for part in self.dataset.simulated], self.dataset.recordings)
        problem.start = problem._started()
        return problem

    def _dataset_of(self, simulated: Sequence[SimulatedRecording],
                    recordings: Sequence[Recording]) -> Dataset:
        return dataset_of(simulated, recordings, free_sensitivities, self.undivided)

    def against(self, model: StageModel, effects: Sequence[Effect]) -> float:
        """Return the minimised function for a model and effects without fitting."""
        dataset = simulated_by(self.dataset, model, self.new_count, frozenset())
        nuisance = dataset.regressors[:, : dataset.nuisance_count]
        errors = JointErrors(
            replace(dataset, regressors=nuisance), self.start.estimation,
            self.start.estimation | self.start.validation, self.new_count, effects, frozenset())
        return errors.value(errors.vector(np.zeros(0), effects))

    def _started(self) -> Regression:
        """Weigh the rows by the residual of the initial model."""
        first = _weighed(self.dataset, self.noise)
        return _weighed(
            self.dataset, self.noise, first.fit(self.own).residual * first.tolerance_um)

    @cached_property
    def _pieces_um(self) -> list[list[FloatArray]] | None:
        return kept_pieces_um(self.dataset.simulated, self.dataset.model)

    def fit(self, effects: Sequence[Effect], later: Iterable[str] = (),
            begun: JointFit | None = None, held: Sequence[Effect] = ()) -> JointFit:
        """Fit the model's parameters and those of effects.

        `effects` are initial guesses of all effects, including those of the model, and `later`
        names those that appeared after the identification. The fit starts from the model and
        problem of `begun`, by default from this problem.

        The effects in `held` are not fitted and act last. If there are any, the fit takes one step
        with the derivatives of `begun`, enough to determine which of them are promising.
        """
        goes_on_in = None if begun is None else begun.problem
        if goes_on_in is not None and goes_on_in is not self:
            return goes_on_in.fit(effects, later, begun, held)
        appeared, effects = frozenset(later), tuple(effects)
        errors = JointErrors(
            self.dataset, self.start.estimation, self.start.estimation | self.start.validation,
            self.new_count, effects, appeared, held, self._pieces_um,
            begun.columns if begun is not None and held else None)
        changes = np.zeros(errors.count) if begun is None else begun.changes
        first = errors.vector(changes, effects) if held else self._first(
            errors, changes, effects, begun, appeared)
        descent = descend(errors, first, 1 if held else self.steps, SETTINGS.worthwhile)
        found = errors.effects_at(descent.vector)
        dataset = errors.dataset_at(descent.vector)
        residual_um = _residual_um(replace(self.start, dataset=dataset), found)
        return JointFit(
            _weighed(dataset, self.noise, residual_um), found, appeared,
            errors.covariance(descent.vector), descent.has_converged,
            descent.vector[: errors.count], descent.gain, descent.value,
            errors.recurrence_count(descent.vector), self, errors.columns_of_effects)

    def _first(self, errors: JointErrors, changes: FloatArray, effects: tuple[Effect, ...],
               begun: JointFit | None, appeared: frozenset[str]) -> FloatArray:
        """Return initial unknowns: effects as guessed, or fitted with a linearised model."""
        guessed = errors.vector(changes, effects)
        regression = self.start if begun is None else begun.regression
        if not effects or begun is not None and begun.effects == effects:
            return guessed
        regression = regression.simulated_as(simulated_by(
            regression.dataset, regression.dataset.model, self.new_count, appeared))
        fit = fit_effects(regression, effects, quick=True)
        most = errors.longest[: errors.count]
        moved = np.clip(fit.coefficients[regression.dataset.nuisance_count :], -most, most)
        return min((guessed, errors.vector(changes, fit.effects),
                    errors.vector(changes + moved, fit.effects)), key=errors.value)


def _residual_um(regression: Regression, effects: Sequence[Effect]) -> FloatArray:
    return regression.tolerance_um * regression.as_given(effects).residual


def _weighed(dataset: Dataset, noise: NoiseEstimate,
             residual_um: FloatArray | None = None) -> Regression:
    """Weigh the rows by their numbers of independent errors; the prior has unit width.

    The scale of a row is the tolerance of its recording, or the correlated residual where that is
    larger.
    """
    good = dataset.for_estimation & ~dataset.at_rows(noise.outliers)
    least_um = np.hypot(noise.noise_um, accuracies_um(dataset))
    scale_um = dataset.of_each(least_um if residual_um is None else [
        max(least, correlated_scale(residual_um[mask & good]))
        for least, mask in zip(least_um, dataset.masks(), strict=True)])
    return regression_with(dataset, noise, scale_um, 1.0)
