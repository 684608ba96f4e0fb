# SPDX-License-Identifier: BSD-3-Clause
"""Whole models that are compared, with each effect present from the start or only later.

An alternative is a model whose parameters and effects are estimated from the recordings of the
identification and the new ones together.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.linalg import block_diag

from piezo_common.arrays import FloatArray
from piezo_common.budget import while_time_lasts
from piezo_common.progress_part import Progress, part_of
from piezo_common.side_by_side import side_by_side
from piezo_identification.diagnosis.joint.probabilities import (
    NONE,
    Evidence,
    ExpectedErrors,
    logarithms_of_evidence,
)
from piezo_identification.fitting.joint_fit import JointFit, JointProblem
from piezo_identification.fitting.model_weights import expected_widths, held_out_of
from piezo_identification.fitting.recording_evidence import recording_evidence
from piezo_identification.fitting.regression import Regression, accuracies_um
from piezo_models.effects import Effect, fitted_values, known_effects, with_fitted_values

CONTINUED = 5
"""Largest number of continued fits, each of several steps."""

HOPEFUL = 3.0
"""A fit is continued if its deficit of evidence is less than this multiple of the gain of its last
step."""


def from_afar(problem: JointProblem, simpler: JointFit, guesses: Sequence[Effect],
              nearby: JointFit) -> JointFit:
    """Return the best fit of an effect: the given one, or one that starts from a changed model.

    The model's parameters compensate for most of an effect that was present at the identification.
    The effect then looks smaller than it is, and a fit from there underestimates it. `simpler` is
    the fit without the effect; the given fit, `nearby`, started from the first of the guesses.
    """
    held = _held(problem, simpler, guesses[1:])
    if held is not None and _may_lead(held, nearby):
        nearby = _better(problem.fit(held.effects, begun=held), nearby)
    fit = _taken_out(problem, simpler, guesses)
    return nearby if fit is None else _better(continued(problem, fit, nearby), nearby)


def continued(problem: JointProblem, fit: JointFit, best: JointFit | None = None,
              most: int = CONTINUED, report: Callable[[int], None] = lambda turn: None) -> JointFit:
    """Continue a fit until there is nothing to gain, or until the best is too far ahead."""
    for turn in range(most):
        if fit.has_converged or best is not None and not _may_lead(fit, best):
            break
        report(turn)
        fit = problem.fit(fit.effects, fit.later, fit)
    return fit


def _better(*fits: JointFit) -> JointFit:
    return min(fits, key=lambda fit: fit.against)


def _may_lead(fit: JointFit, best: JointFit) -> bool:
    """Return whether a fit may still become better than the best when it is continued."""
    return fit.against - HOPEFUL * fit.gain < best.against


def _held(problem: JointProblem, simpler: JointFit, guesses: Sequence[Effect]) -> JointFit | None:
    """Fit the model by one step with each guess held fixed, and return the best."""
    fits = [problem.fit(simpler.effects, begun=simpler, held=(guess,)) for guess in guesses]
    return _better(*fits) if fits else None


def _taken_out(problem: JointProblem, simpler: JointFit,
               guesses: Sequence[Effect]) -> JointFit | None:
    """Remove the best guess from the hysteresis that contains it, and fit both from there."""
    model, found = problem.dataset.model, []
    for guess in guesses:
        ahead = guess.hysteresis_ahead(model.hysteresis)
        if ahead is not None:
            made_way = replace(model, hysteresis=ahead)
            effects = (*simpler.effects, guess)
            found.append((problem.against(made_way, effects), made_way, effects))
    if not found:
        return None
    _, made_way, effects = min(found, key=lambda entry: entry[0])
    return problem.about(made_way).fit(effects)


class Appearance(StrEnum):
    """When an effect appeared, as far as the recordings of the identification show."""

    BEFORE = "before the identification"
    AFTER = "after the identification"
    NOT_DECIDABLE = "not decidable"
    NOT_ASKED = "not asked"


@dataclass(frozen=True)
class AlternativeSettings:
    """Which alternatives are fitted."""

    fitted: int = 4
    """Number of effects that are fitted as present from the start, the most promising ones."""
    starts: int = 5
    """Number of initial guesses of each that are fitted if the best of them leave more than
    noise."""
    second: float = 1.3
    """Residual power of the best alternative, relative to the noise, above which a second effect is
    tried in addition."""
    most_effects: int = 2
    """Largest number of effects present from the start."""
    many_samples: int = 500_000
    """Total number of samples above which only one effect, besides those that explain the new
    recordings, is fitted as present from the start, because the cost of a fit is proportional to
    the length of the recordings."""
    decided: float = float(np.log(19.0))
    """Logarithm of the probability ratio, 95 to 5, above which the time when an effect appeared is
    considered known."""


SETTINGS = AlternativeSettings()


@dataclass(frozen=True, eq=False)
class Alternative:
    """A model in the comparison."""

    names: tuple[str, ...]
    """Sorted names of the effects that the given model lacks; empty for the model alone."""
    since: bool
    """True if the effects appeared after the identification."""
    fit: JointFit

    evidence: Evidence
    """Quantities on which its probability depends."""


def settled(problem: JointProblem, progress: Progress) -> JointFit:
    """Fit the model without additional effects until no step is worthwhile."""
    def report(turn: int) -> None:
        progress("all recordings together: no effect",
                 0.2 / SETTINGS.most_effects * (turn + 1) / CONTINUED)

    report(-1)
    return continued(problem, problem.fit(problem.own), most=CONTINUED - 1, report=report)


def compete(problem: JointProblem, none: JointFit, since: Sequence[Sequence[Effect]],
            expected: ExpectedErrors, progress: Progress) -> list[Alternative]:
    """Fit the alternatives, first the model without additional effects.

    The sets in `since` may explain the new recordings alone, the best first.
    """
    alternatives = [alternative_of((), none)]
    named = {tuple(sorted(effect.name for effect in effects)): effects for effects in since}
    for names, effects in named.items():
        if names and not {effect.name for effect in none.effects} & set(names):
            fit = problem.fit((*none.effects, *effects), names, none)
            alternatives.append(alternative_of(names, fit, True))
    if any(_is_at_noise(problem, each) for each in alternatives):
        # No error remains that another effect could explain.
        return _possible(problem, alternatives)
    best, asked = alternatives[0], {name for names in named for name in names}
    samples = sum(part.measured_um.size for part in problem.dataset.simulated)
    is_long = samples > SETTINGS.many_samples
    with while_time_lasts("further effects in all recordings"):
        for turn in range(1 if is_long else SETTINGS.most_effects):
            guesses = _promising(problem, best.fit.regression, best.fit.effects, asked)
            guesses = guesses[: len(since[0]) + (1 if is_long else SETTINGS.fitted)]
            fitted = _each_with_guess(problem, best, guesses, _turn_of(progress, turn))
            if turn == 0 and not is_long and not any(
                    _is_at_noise(problem, each, problem.new_count) for each in fitted):
                fitted = _from_afar(problem, best, guesses, fitted)
            alternatives = converged(
                problem, _possible(problem, [*alternatives, *fitted]), expected)
            now = most_probable(alternatives, expected)
            if now is best or now.since or _is_at_noise(problem, now, problem.new_count):
                break
            best = now
    return alternatives


def converged(problem: JointProblem, alternatives: Sequence[Alternative],
              expected: ExpectedErrors) -> list[Alternative]:
    """Continue fits that may still become the most probable; omit impossible alternatives."""
    alternatives = list(alternatives)
    for _ in range(CONTINUED):
        logarithms = _logarithms(alternatives, expected)
        behind = np.max(logarithms) - logarithms
        numbers = [number for number, each in enumerate(alternatives)
                   if not each.fit.has_converged and not _is_at_noise(problem, each)
                   and behind[number] < HOPEFUL * each.fit.gain]
        if not numbers:
            break
        further = side_by_side(
            lambda each: alternative_of(each.names, problem.fit(
                each.fit.effects, each.fit.later, each.fit), each.since),
            [alternatives[number] for number in numbers])
        for number, each in zip(numbers, further, strict=True):
            alternatives[number] = each
    return _possible(problem, alternatives)


def asked_when(problem: JointProblem, alternatives: Sequence[Alternative],
               expected: ExpectedErrors) -> list[Alternative]:
    """Add the most probable alternative with its effects present from the start, if they are not.

    Only the comparison of both shows when the effects appeared.
    """
    best = most_probable(alternatives, expected)
    is_known = any(each.names == best.names and not each.since for each in alternatives)
    if not best.since or is_known or not all(
            effect.of_the_stage or effect.recurs for effect in best.fit.effects):
        return list(alternatives)
    along = alternative_of(best.names, problem.fit(best.fit.effects, begun=best.fit))
    return converged(problem, [*alternatives, along], expected)


def fits_of_free_model(problem: JointProblem, sets: Sequence[Sequence[Effect]],
                       expected: ExpectedErrors) -> list[Alternative]:
    """Fit each set of effects together with all parameters of the model."""
    def fitted(effects: Sequence[Effect]) -> Alternative:
        return alternative_of([effect.name for effect in effects],
                            problem.fit((*problem.own, *effects)))

    return converged(problem, side_by_side(fitted, sets), expected)


def _each_with_guess(problem: JointProblem, best: Alternative, guesses: Sequence[Sequence[Effect]],
                     progress: Progress) -> list[Alternative]:
    """Fit one more effect in addition to those of an alternative, from the best guess of each."""
    def fitted(of_kind: Sequence[Effect]) -> Alternative:
        return alternative_of((*best.names, of_kind[0].name), problem.fit(
            (*best.fit.effects, of_kind[0]), begun=best.fit))

    return side_by_side(fitted, guesses, lambda number: progress(
        f"all recordings together: {guesses[number][0].name}", number / len(guesses)))


def _from_afar(problem: JointProblem, best: Alternative, guesses: Sequence[Sequence[Effect]],
               fitted: Sequence[Alternative]) -> list[Alternative]:
    """Return the better fit of each effect: the given one, or one refitted with a held guess."""
    def better(entry: tuple[Sequence[Effect], Alternative]) -> Alternative:
        of_kind, nearby = entry
        fit = from_afar(problem, best.fit, of_kind, nearby.fit)
        return nearby if fit is nearby.fit else alternative_of(nearby.names, fit)

    return side_by_side(better, list(zip(guesses, fitted, strict=True)))


def _turn_of(progress: Progress, turn: int) -> Progress:
    """Return the progress function of one turn, after the fit of the model alone."""
    return part_of(
        progress, (turn + 0.2) / SETTINGS.most_effects, (turn + 1) / SETTINGS.most_effects)


def _logarithms(alternatives: Sequence[Alternative], expected: ExpectedErrors) -> FloatArray:
    """Return the log-evidence of each alternative, relative to the others."""
    return logarithms_of_evidence([each.evidence for each in alternatives], expected)


def most_probable(alternatives: Sequence[Alternative], expected: ExpectedErrors) -> Alternative:
    """Return the alternative with the largest evidence."""
    return alternatives[int(np.argmax(_logarithms(alternatives, expected)))]


def times_of_coming(alternatives: Sequence[Alternative],
                    expected: ExpectedErrors) -> dict[tuple[str, ...], Appearance]:
    """Return when each set of effects that was tried appeared, as far as the recordings show.

    A set with an effect that depends on when a recording begins can only have appeared later.
    """
    logarithms = _logarithms(alternatives, expected)
    best: dict[tuple[str, ...], dict[bool, float]] = {}
    for each, logarithm in zip(alternatives, logarithms, strict=True):
        ways = best.setdefault(each.names, {})
        ways[each.since] = max(logarithm, ways.get(each.since, -np.inf))
    times = {}
    for names, ways in best.items():
        gain = ways.get(False, -np.inf) - ways.get(True, -np.inf)
        times[names] = (Appearance.NOT_DECIDABLE if abs(gain) < SETTINGS.decided
                        else Appearance.BEFORE if gain > 0.0 else Appearance.AFTER)
    return times


def _is_at_noise(problem: JointProblem, alternative: Alternative,
                 count: int | None = None) -> bool:
    """Return whether the residual of the first or all recordings is too small for an effect."""
    noise = np.array(problem.noise.noise_um) ** 2 + accuracies_um(problem.dataset) ** 2
    is_small = np.array(alternative.evidence.mean_square_um2) < SETTINGS.second * noise
    return bool(np.all(is_small[:count]))


def _possible(problem: JointProblem, alternatives: Sequence[Alternative]) -> list[Alternative]:
    """Return the physically possible alternatives; the first is always kept."""
    extent = problem.dataset.extent
    return [alternatives[0], *(
        alternative for alternative in alternatives[1:]
        if not any(effect.impossible(extent) for effect in alternative.fit.effects))]


def alternative_of(names: Sequence[str], fit: JointFit, since: bool = False) -> Alternative:
    """Return an alternative with the quantities on which its probability depends."""
    names = tuple(sorted(names))
    evidence = Evidence.weighed(
        "+".join(names) or NONE, held_out_of(fit), fit.covariance,
        expected_widths(fit.effects, fit.regression.dataset.extent), fit.recurrence_count)
    return Alternative(names, since, fit, evidence)


def _promising(problem: JointProblem, regression: Regression, own: Sequence[Effect],
               asked: set[str]) -> list[list[Effect]]:
    """Return guesses of each effect, the most promising effects first.

    After the best guess of an effect come a few others, spread over all. Effects that were named
    for the new recordings come before all others.
    """
    evidence = recording_evidence(regression, own)
    # The diagnosed recordings, and the one of the identification with the worst fit.
    old = range(problem.new_count, len(evidence))
    worst = max(old, key=lambda index: np.std(evidence[index].residual_um)
                / evidence[index].noise_um)
    decisive = [*evidence[: problem.new_count], evidence[worst]]
    present = {effect.name for effect in own}

    def tried(kind: type[Effect]) -> list[tuple[float, list[Effect]]]:
        if not (kind.of_the_stage or kind.recurs) or (
                kind.name in present and not kind.several):
            return []
        if all(kind.lacks_excitation(shown) for shown in evidence):
            return []
        asked_for = decisive if kind.of_the_stage else evidence[: problem.new_count]
        guesses = [with_fitted_values(guess, fitted_values(guess, problem.dataset.extent)[0])
                   for shown in asked_for for guess in kind.starts(shown)]
        costs = [_cost(problem, regression, own, guess) for guess in guesses]
        if not guesses:
            return []
        ordered = [guesses[number] for number in np.argsort(costs)]
        spread = np.linspace(0, len(ordered) - 1, min(len(ordered), SETTINGS.starts), dtype=int)
        return [(min(costs), [ordered[number] for number in spread])]

    found = [entry for entries in side_by_side(tried, list(known_effects().values()))
             for entry in entries]
    found.sort(key=lambda entry: (entry[1][0].name not in asked, entry[0]))
    return [of_kind for _, of_kind in found]


def _cost(problem: JointProblem, regression: Regression, own: Sequence[Effect],
          guess: Effect) -> float:
    """Return the sum of squares with a guess in addition to the model's own effects."""
    residual = regression.remainder(regression.difference((*own, guess), (guess,)))
    if guess.recurs:
        dataset = regression.dataset
        blocks = [guess.recurrence(part.time_s[rows], part.time_s[-1])
                  for part, rows in zip(dataset.simulated, dataset.rows, strict=True)]
        of_its_own = block_diag(*(
            np.zeros((len(block), 0)) if index < problem.new_count else block
            for index, block in enumerate(blocks))) / regression.tolerance_um[:, None]
        signals = np.column_stack([regression.remainder(signal) for signal in of_its_own.T])
        residual = residual - signals @ np.linalg.lstsq(signals, residual, rcond=1e-9)[0]
    return float(residual @ residual)
