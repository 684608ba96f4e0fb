# SPDX-License-Identifier: BSD-3-Clause
"""Result of the comparison of models: probabilities, and the most probable alternative."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from piezo_common.budget import while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_identification.diagnosis.comparison.criteria import is_noise
from piezo_identification.diagnosis.comparison.selection import (
    Selection,
    in_place_of_the_found,
    select_effects,
)
from piezo_identification.diagnosis.joint.alternatives import (
    Alternative,
    Appearance,
    asked_when,
    compete,
    fits_of_free_model,
    most_probable,
    settled,
    times_of_coming,
)
from piezo_identification.diagnosis.joint.probabilities import (
    BELIEVED,
    NONE,
    SOMETHING_ELSE,
    Evidence,
    ExpectedErrors,
    expected_errors,
    label_of,
    probabilities,
)
from piezo_identification.fitting.dataset import Dataset, dataset_of, simulate_recordings
from piezo_identification.fitting.evidence import log_evidence
from piezo_identification.fitting.free_parameters import free_count
from piezo_identification.fitting.joint_fit import JointFit, JointProblem
from piezo_identification.fitting.model_weights import (
    expected_widths,
    held_out_of,
    held_out_rows,
)
from piezo_identification.fitting.regression import (
    Fit,
    Regression,
    accuracies_um,
    first_regression,
    reweighted,
)
from piezo_identification.fitting.structure_search import loudest_mode
from piezo_identification.fitting.whole_model import WholeFit, WholeModel
from piezo_identification.simulation.past_search import simulated_recording
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect, known_effects
from piezo_models.effects.band_limited_voltage import BandLimitedVoltage
from piezo_models.effects.outliers import Outliers
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.recording import Recording

LIKELY = 0.05
"""Probability relative to the largest above which a set is indistinguishable from the best."""


MOST_OTHERS = 3
"""Number of sets with nearly as small a residual of the new recordings that are compared as
well."""

LARGEST_RESIDUAL = 2.0
"""Largest residual relative to that of the given model, on the new recordings and on the old ones,
for which a simple model is worth a comparison of effects: hysteresis, creep and further modes then
explain less than half of the misfit."""

STEPS = 20
"""Largest number of steps of its fit."""


@dataclass(frozen=True, eq=False)
class Competition:
    """Probabilities of the compared models, and the most probable one."""

    probabilities: dict[str, float]
    """Probability of each relevant set of effects, of `none` and of `something_else`; they sum to
    one."""
    best: Alternative | None = None
    """The most probable model; None if only the new recordings were used, with the given model."""
    times: dict[tuple[str, ...], Appearance] = field(default_factory=dict)
    """When each compared set of effects appeared."""
    stated_um: float = 0.0
    """RMS of the known error of the most probable model."""
    is_plain: bool = False
    """True if it is the simplest model with effects, not the given one."""

    def appearance(self, names: Iterable[str]) -> Appearance:
        """Return when a set of effects appeared."""
        if not self.times:
            return Appearance.NOT_ASKED
        return self.times.get(tuple(sorted(names)), Appearance.NOT_DECIDABLE)

    def indistinguishable(self) -> dict[str, str]:
        """Return probable effects of other sets, and the best set's effect that each replaces."""
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
                   selection: Selection, stated_um: float | None,
                   progress: Callable[[str, float], None]) -> Competition:
    """Compare models on all recordings, or sets of effects on the new ones alone.

    The recordings of the identification, the old ones, are not used if the model leaves only noise.
    All have the sign of the model, and marked outliers. The known error of the model is estimated
    from the old ones if `stated_um` is None.
    """
    if not old or is_noise(selection.regression, selection.start):
        stated_um = stated_um or 0.0
        return Competition(_of_new_recordings(selection, stated_um), stated_um=stated_um)
    problem = JointProblem(
        model, new, old, simulated=selection.regression.dataset.simulated)
    none = settled(problem, progress)
    # This is the known error, except for what an alternative explains in the recordings of the
    # identification.
    residual_um = residual_of_old_um(problem, none)
    expected = _expected(problem, residual_um if stated_um is None else min(stated_um, residual_um))
    alternatives = asked_when(
        problem, compete(problem, none, _sets(selection), expected, progress), expected)
    best = most_probable(alternatives, expected)
    residual_um = residual_of_old_um(problem, best.fit)
    stated_um = residual_um if stated_um is None else min(stated_um, residual_um)
    return Competition(_probabilities(problem, alternatives, stated_um), best,
                       times_of_coming(alternatives, _expected(problem, stated_um)), stated_um)


def residual_of_old_um(problem: JointProblem, fit: JointFit) -> float:
    """Return the largest residual beyond noise of the recordings of the identification."""
    residual_um2 = np.array([held_out.mean_square_um2 for held_out in held_out_of(fit)])
    beyond = np.maximum(0.0, residual_um2 - np.square(problem.noise.noise_um))
    return float(np.sqrt(np.max(beyond[problem.new_count :])))


def _expected(problem: JointProblem, stated_um: float) -> ExpectedErrors:
    return expected_errors(problem.dataset, problem.noise.noise_um, stated_um)


def _probabilities(problem: JointProblem, alternatives: Sequence[Alternative],
                   stated_um: float) -> dict[str, float]:
    """Return the probabilities of models that were fitted to all recordings."""
    return probabilities([each.evidence for each in alternatives], _expected(problem, stated_um),
                         problem.new_count)


def with_free_model(competition: Competition, model: StageModel, new: Sequence[Recording],
                    selection: Selection) -> Competition:
    """Refit the model together with the selected effects if it explains nothing as given.

    Without the recordings of the identification, effects are fitted with the given model and small
    changes of it. The error of a model that was identified while the effect was present is larger.
    Some of the effects may then be sufficient.
    """
    effects = selection.end.effects
    explains = competition.probabilities[SOMETHING_ELSE] < BELIEVED
    if explains or not effects or selection.interrupted or competition.times:
        return competition
    problem = JointProblem(model, new, [], simulated=selection.regression.dataset.simulated)
    stated_um = competition.stated_um
    expected = _expected(problem, stated_um)
    smaller = [fit.effects for fit in selection.parts if _names(fit) < _names(selection.end)]
    fitted = fits_of_free_model(problem, [effects, *smaller], expected)
    return replace(competition, probabilities=_probabilities(problem, fitted, stated_um),
                   best=most_probable(fitted, expected))


def with_plain_model(competition: Competition, model: StageModel, new: Sequence[Recording],
                     old: Sequence[Recording], selection: Selection,
                     progress: Callable[[str, float], None]) -> Competition:
    """Compare effects with the simplest model, if its error is not much larger.

    The given model is then too large for what it explains: hysteresis, creep and further modes may
    imitate the effect of nonlinear mechanics.
    """
    probable = max(competition.probabilities, key=competition.probabilities.__getitem__)
    if probable == NONE or selection.interrupted or is_plain(model):
        return competition
    regression = selection.regression
    residual_um = regression.residual_um(regression.as_given())
    with while_time_lasts("effects added to a line and one mode"):
        check_cancelled()
        plain = plain_model(model, new, old, residual_um)
        if plain is None:
            return competition
        stated_um = competition.stated_um
        problem, fitted = fits_of_plain_model(
            plain, new, old, lambda problem: _expected(problem, stated_um), progress)
        expected = _expected(problem, stated_um)
        best = most_probable(fitted, expected)
        before = competition.best
        given = _evidence_of_model(
            regression.dataset, _evidence_of(regression, selection.end),
            selection.end.parameter_count) if before is None else _evidence_of_alternative(before)
        if best.names and _evidence_of_alternative(best) > given:
            return replace(competition, probabilities=_probabilities(problem, fitted, stated_um),
                           best=best, times=times_of_coming(fitted, expected) if old else {},
                           is_plain=True)
    return competition


def _evidence_of_alternative(alternative: Alternative) -> float:
    fit = alternative.fit
    return _evidence_of_model(fit.regression.dataset, alternative.evidence, fit.count)


def _evidence_of_model(dataset: Dataset, evidence: Evidence, effect_numbers: int) -> float:
    """Return the log-evidence of a model with its effects, including its own parameters."""
    squares_um2 = np.array(evidence.mean_square_um2) + accuracies_um(dataset) ** 2
    return log_evidence(squares_um2, free_count(dataset.model) + effect_numbers)


def _sets(selection: Selection) -> list[tuple[Effect, ...]]:
    """Return the sets of effects that explain the new recordings alone, the best first.

    Without the other sets, the probability of the best would not show that others fit as well.
    """
    smaller = [fit for fit in selection.parts
               if len(fit.effects) == len(selection.end.effects) - 1]
    return [fit.effects for fit in (
        selection.end, *selection.alternatives[:MOST_OTHERS], *smaller)]


def led_by_the_most_probable(selection: Selection, competition: Competition) -> Selection:
    """Return a selection that begins with the most probable of its sets.

    Nothing changes if the most probable effects were present from the start.
    """
    if competition.best is not None and not competition.best.since:
        return selection
    first = _names(selection.end)
    fits = [selection.end, selection.start, *selection.parts, *selection.alternatives]
    best = max(fits, key=lambda fit: competition.probabilities.get(label_of(fit.effects), 0.0))
    if best is selection.end:
        return selection
    alike = selection.indistinguishable
    if new := _names(best) - first:
        alike = {name: found if found in _names(best) else min(new)
                 for name, found in alike.items()} | dict.fromkeys(first - _names(best), min(new))
    others = tuple(fit for fit in (selection.end, *selection.alternatives) if fit is not best)
    return replace(selection, end=best, alternatives=others, indistinguishable={
        name: found for name, found in alike.items()
        if found in _names(best) and name not in _names(best)})


def probabilities_of_named(competition: Competition, regression: Regression, fit: Fit,
                           refused: Iterable[str]) -> dict[str, float]:
    """Return the probabilities, in descending order, if a fit to the new recordings is named.

    The probability of something else is that for this fit. The sets of effects share the rest as in
    the comparison, without those that the held-out data refuse. If the most probable set is not
    that of the fit, the comparison does not apply, and the set of the fit gets the whole rest.
    """
    label, without = label_of(fit.effects), set(refused)
    other = _of_fits(regression, [fit], competition.stated_um)[SOMETHING_ELSE]
    kept = {each: share for each, share in competition.probabilities.items()
            if each != SOMETHING_ELSE and share > 0.0 and not without & set(each.split("+"))}
    if max(kept, key=kept.__getitem__, default="") != label:
        kept = {label: 1.0}
    whole = sum(kept.values())
    shares = {each: (1.0 - other) * share / whole for each, share in kept.items()}
    return dict(sorted((shares | {SOMETHING_ELSE: other}).items(), key=lambda entry: -entry[1]))


def _names(fit: Fit) -> set[str]:
    return {effect.name for effect in fit.effects}


def _of_new_recordings(selection: Selection, stated_um: float) -> dict[str, float]:
    """Return the probabilities of the sets that the new recordings alone do not exclude."""
    fits = [selection.start, selection.end, *selection.parts, *selection.alternatives]
    return _of_fits(
        selection.regression, fits if selection.end.effects else fits[:1], stated_um)


def _of_fits(regression: Regression, fits: Sequence[Fit], stated_um: float) -> dict[str, float]:
    """Return the probabilities of fits to the new recordings alone."""
    expected = expected_errors(regression.dataset, regression.noise.noise_um, stated_um)
    return probabilities([_evidence_of(regression, fit) for fit in fits], expected,
                         len(regression.dataset.recordings))


def _evidence_of(regression: Regression, fit: Fit) -> Evidence:
    """Return the quantities on which the probability of a fit to the new recordings depends."""
    widths = expected_widths(
        [effect for effect in fit.effects if type(effect) is not Outliers],
        regression.dataset.extent)
    return Evidence.weighed(
        label_of(fit.effects), held_out_rows(regression, fit), fit.covariance, widths)


def selection_from(selection: Selection, competition: Competition,
                   alternative: Alternative) -> Selection:
    """Return a selection, relative to its model, of the effects that an alternative has."""
    effects, count = alternative.fit.effects, len(alternative.names)
    own, added = effects[: len(effects) - count], effects[len(effects) - count :]
    model = replace(alternative.fit.regression.dataset.model, effects=own)
    before = selection.regression
    moved = replace(before, dataset=_with_model(before.dataset, model, competition.is_plain))
    regression = reweighted(moved, added)
    covariance = alternative.fit.covariance
    if covariance is not None:
        numbers = regression.fit(added).parameter_count
        covariance = covariance[len(covariance) - numbers :, len(covariance) - numbers :]
    end = regression.fit(added, covariance)
    alike: dict[str, tuple[str, Fit]] = {}
    with while_time_lasts("other effects in the place of those found"):
        check_cancelled()
        alike = in_place_of_the_found(regression, list(known_effects().values()), end)
    names = {name: found for name, (found, _) in alike.items()}
    return replace(selection, regression=regression, end=end,
                   indistinguishable=names | competition.indistinguishable())


def _with_model(dataset: Dataset, model: StageModel, has_other_parameters: bool) -> Dataset:
    """Simulate another model on the same rows; its parameters may have other sensitivities."""
    simulated = tuple(part.with_model(model) for part in dataset.simulated)
    if has_other_parameters:
        return dataset_of(simulated, dataset.recordings)
    return replace(dataset, model=model, simulated=simulated)


def is_plain(model: StageModel) -> bool:
    """Return whether a model already is just a line and a mode."""
    return not (
        model.has_hysteresis or model.creep.poles_rad_per_s or model.dynamics.time_constant_s > 0.0
        or model.effects_at("modes") or len(model.dynamics.mode_frequencies_rad_per_s) > 1)


def plain_model(model: StageModel, new: Sequence[Recording], old: Sequence[Recording],
                residual_um: float) -> StageModel | None:
    """Fit a line and the loudest mode of a model, with a held voltage and with a smooth one.

    The recordings have the sign of the model, and marked outliers. Return the better one, or None
    if the model has no mode, or both fit far worse than it does, which leaves `residual_um` RMS in
    the new recordings. An effect that came after the identification adds to both residuals of the
    new recordings, but to none of the old ones.
    """
    if model.dynamics.is_static and not model.effects_at("modes"):
        return None
    recordings = [*new, *old]
    period_s = float(min(each.sample_periods_s.min() for each in recordings))
    bare = StageModel(_line(model, recordings), CreepDynamics(), loudest_mode(model, period_s))
    problem = WholeModel(bare, recordings, [0.0] * len(recordings))
    starts: list[tuple[StageModel, float | None]] = [(bare, None)]
    if problem.is_sampled:
        starts.append((replace(bare, effects=(BandLimitedVoltage(),)), 0.5 * period_s))
    best = min((_fitted(problem, *start) for start in starts), key=_residual_rms_um)
    of_given_um = [simulated_recording(model, each).error_um() for each in old]
    is_close = _residual_rms_um(best, slice(len(new))) < LARGEST_RESIDUAL * residual_um and (
        not old or _residual_rms_um(best, slice(len(new), None))
        < LARGEST_RESIDUAL * np.sqrt(np.mean(np.square(of_given_um))))
    return best.delayed_model if is_close else None


def fits_of_plain_model(plain: StageModel, new: Sequence[Recording], old: Sequence[Recording],
                        expected: Callable[[JointProblem], ExpectedErrors],
                        report: Callable[[str, float], None],
                        ) -> tuple[JointProblem, list[Alternative]]:
    """Select the effects that recordings show with a simple model; refit all, and some of them."""
    dataset = simulate_recordings(plain, [*new, *old])
    selection = select_effects(first_regression(dataset), report)
    problem = JointProblem(plain, new, old, simulated=dataset.simulated)
    sets = [fit.effects for fit in (selection.end, *selection.parts)]
    return problem, fits_of_free_model(problem, sets, expected(problem))


def _fitted(problem: WholeModel, model: StageModel, delay_s: float | None) -> WholeFit:
    """Fit a model whose delay must not be negative, because rows are read as in the given one."""
    fit = problem.fit(model, delay_s, STEPS)
    return fit if (fit.delay_s or 0.0) >= 0.0 else problem.fit(fit.model, None, STEPS)


def _line(model: StageModel, recordings: Sequence[Recording]) -> PreisachModel:
    """Return a line over the voltages of the recordings, with the gain of a model."""
    low_v, high_v = model.hysteresis.voltage_min_v, model.hysteresis.voltage_max_v
    low_v = min(low_v, *(float(np.min(each.voltage_v)) for each in recordings))
    high_v = max(high_v, *(float(np.max(each.voltage_v)) for each in recordings))
    return PreisachModel.line(low_v, high_v, model.hysteresis.mean_gain_um_per_v,
                              model.hysteresis.offset_um)


def _residual_rms_um(fit: WholeFit, recordings: slice = slice(None)) -> float:
    """Return the RMS residual of the fitted rows of some recordings."""
    residual_um = [fitted for fitted, _ in fit.residual_um[recordings]]
    return float(np.sqrt(np.mean(np.concatenate(residual_um) ** 2)))
