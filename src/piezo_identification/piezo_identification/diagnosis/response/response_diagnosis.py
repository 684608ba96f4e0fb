# SPDX-License-Identifier: BSD-3-Clause
"""What a model lacks to explain a measured frequency response: a comparison of linear effects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from piezo_common.arrays import ComplexArray
from piezo_common.budget import Budget, spending, while_time_lasts
from piezo_common.progress_part import Progress
from piezo_identification.analysis.gain_over_frequency import band_of_most
from piezo_identification.diagnosis.comparison.criteria import Reason, Undecided
from piezo_identification.diagnosis.evidence.effect_entries import (
    add_deviations,
    with_stand_ins,
)
from piezo_identification.diagnosis.evidence.recording_faults import wrong_sign
from piezo_identification.diagnosis.response.response_effect_fit import ResponseProblem
from piezo_identification.diagnosis.verdict import Verdict
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_hold import without_hold
from piezo_identification.estimators.frequency_response.response_search import STEPS
from piezo_identification.fitting.dataset import SPLIT
from piezo_identification.fitting.structure_search import SETTINGS as SEARCH
from piezo_identification.fitting.structure_search import apart, is_better
from piezo_identification.fitting.whole_model import WholeFit
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect
from piezo_models.effects.creep import Creep
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode

SLOWEST = 10
"""One frequency in this many, from the lowest, determines the sign of the sensor."""

FEWEST_FREQUENCIES = SPLIT.stretches // 2
"""Fewest frequencies of a response, of which a third is held out."""

FIRST_STEPS = 2
"""Largest number of steps of a fit from each guess; the best of them gets more."""

MOST_EFFECTS = 4
"""Number of kinds of linear effects."""

NEAR_NOISE = 3.0
"""Largest residual of an explained response, relative to its noise."""

GUESSED_MODES = 27
"""Number of initial frequencies of a mode, so close that one is near any resonance in the range."""

RELAXATIONS = 3
"""Number of time constants of creep over the lower half of the range."""


@dataclass(frozen=True, eq=False, repr=False)
class ResponseDiagnosis(Verdict):
    """A verdict on a frequency response, with its evidence; the effects in the order found.

    Errors are those of the gain: `rms_um` and noise per V, `e_y_percent` the relative norm.
    """

    tried: list[list[tuple[str, float]]]
    """Candidates of each round, and the change of the held-out error in percent."""
    measured: FrequencyResponse

    before_gain: ComplexArray
    after_gain: ComplexArray
    """Gain of the given model and of the extended one at the measured frequencies, (N,)."""


@dataclass(eq=False)
class ResponseSelection:
    """Result of the comparison of linear effects so far."""

    given: WholeFit
    """The given model, in which only the gain is free."""
    fit: WholeFit
    """Fit with the effects found."""
    tried: list[list[tuple[str, float]]] = field(default_factory=list)
    """As in `ResponseDiagnosis`."""
    confounded_with: dict[str, str] = field(default_factory=dict)
    """Effects that the response does not distinguish from one found, and that one."""
    undecided: dict[str, Undecided] = field(default_factory=dict)
    """Effects that are refused, and why."""


def diagnose_response(
    model: StageModel, measured: FrequencyResponse,
    progress: Progress = lambda what, fraction: None, budget: Budget | None = None,
) -> ResponseDiagnosis:
    """Find which linear effect a model lacks to explain a frequency response.

    Creep, a further vibration mode, a delay and a sensor lag are compared by their evidence. Each
    is fitted to two thirds of the frequencies, together with the gain, which the hysteresis does
    not determine, and the model's creep and dynamics within their prior widths. The errors are
    those of the other frequencies. Nonlinear effects do not show in a response.

    A hold in the response is removed. When the time limit is reached, or with Ctrl-C, the
    comparison ends with the effects found so far. Raise ValueError if there are too few
    frequencies.
    """
    if measured.frequency_hz.size < FEWEST_FREQUENCIES:
        raise ValueError(
            f"{measured.path} has {measured.frequency_hz.size} frequencies, too few to hold some "
            f"out: measure at least {FEWEST_FREQUENCIES}"
        )
    measured = without_hold(measured, model.linear())
    is_reversed = moves_against(model, measured)
    if is_reversed:
        measured = replace(measured, gain=-measured.gain)
    problem = ResponseProblem(model, measured)
    budget = budget or Budget()
    with spending(budget):
        selection = select_linear_effects(problem, progress)
    return replace(_diagnosis(problem, selection, is_reversed), not_tried=budget.sentence())


def moves_against(model: StageModel, measured: FrequencyResponse) -> bool:
    """Return whether the sensor has the opposite sign of the model at low frequency."""
    slow = np.argsort(measured.frequency_hz)[: max(1, measured.frequency_hz.size // SLOWEST)]
    gain = measured.gain[slow]
    response = model.small_signal_response(measured.frequency_hz[slow])
    weight = np.abs(gain) * np.abs(response)
    return bool(np.sum((gain * response.conj()).real / np.maximum(weight, 1e-300)) < 0.0)


def select_linear_effects(
    problem: ResponseProblem, progress: Progress = lambda what, fraction: None,
) -> ResponseSelection:
    """Add linear effects one by one while the evidence increases.

    The first may be smaller than the noise of a frequency. A further one must not be named only
    because those found have a slightly other form than the stage: it is sought where more than
    noise remains.
    """
    progress("the model's dynamics", 0.0)
    given = problem.fit((), 0)
    chosen = ResponseSelection(given, problem.fit((), STEPS))
    with while_time_lasts("further linear effects"):
        for _ in range(SEARCH.rounds):
            found = problem.added(chosen.fit)
            count, enough = len(found), NEAR_NOISE if found else SEARCH.above_noise
            if count == MOST_EFFECTS or problem.over_noise(chosen.fit) <= enough:
                break
            # The number of further effects is unknown.
            progress(f"effect {count + 1}", 1.0 - 0.5**count)
            fits = fit_each(problem, _guesses(problem), chosen.fit, found)
            chosen.tried.append([(_last_name(fit), reduction_percent(problem, chosen.fit, fit))
                                 for fit in fits])
            if not fits or not is_better(fits[0], chosen.fit):
                break
            name = _last_name(fits[0])
            before, after = (problem.held_out_errors(fit)["e_y_percent"]
                             for fit in (given, fits[0]))
            if after > before:
                chosen.undecided[name] = Undecided(
                    Reason.WORSE_ON_HELD_OUT, "the error on held-out frequencies would rise from "
                    f"{before:.3g} to {after:.3g} %")
                break
            chosen.confounded_with.update({
                _last_name(fit): name for fit in fits[1:]
                if fit.evidence_over(fits[0]) > -SEARCH.chance})
            chosen.fit = fits[0]
            if count:
                chosen.fit = revised(problem, chosen.fit)
    return chosen


def fit_each(problem: ResponseProblem, guesses: Mapping[type[Effect], Sequence[Effect]],
             begun: WholeFit, found: Sequence[Effect]) -> list[WholeFit]:
    """Fit each kind of guessed effects in addition to others, the one with most evidence first."""
    fits = []
    for kind, of_kind in guesses.items():
        if kind in map(type, found) and not kind.several:
            continue
        first = [problem.fit((*found, guess), FIRST_STEPS, begun) for guess in of_kind]
        promising = [fit for fit in first if has_separate_modes(problem, fit)]
        if promising:
            best = max(promising, key=lambda fit: fit.evidence_over(begun))
            fits.append(problem.fit(problem.added(best), STEPS, best))
    return sorted((fit for fit in fits if has_separate_modes(problem, fit)),
                  key=lambda fit: -fit.evidence_over(begun))


def revised(problem: ResponseProblem, fit: WholeFit) -> WholeFit:
    """Return a fit without effects that later ones made needless, or with similar ones instead."""
    best = fit
    for number in reversed(range(len(problem.added(fit)))):
        effect, others = problem.parted(best, number)
        similar = {kind: guesses for kind, guesses in _guesses(problem).items()
                   if kind.is_confounded_with(type(effect))}
        rivals = [problem.fit(others, STEPS, best), *fit_each(problem, similar, best, others)]
        best = max((rival for rival in rivals if is_better(rival, best)),
                   key=lambda rival: rival.evidence_over(fit), default=best)
    return best


def has_separate_modes(problem: ResponseProblem, fit: WholeFit) -> bool:
    """Return whether the modes found ring and do not overlap: others imitate other forms."""
    modes = [effect for effect in problem.added(fit) if isinstance(effect, VibrationMode)]
    return len(apart(modes)) == len(modes) and all(
        mode.damping_ratio <= SEARCH.most_uncoupled for mode in modes)


def reduction_percent(problem: ResponseProblem, before: WholeFit, after: WholeFit) -> float:
    """Return the reduction of the weighted error on held-out frequencies in percent."""
    return 100.0 * (1.0 - problem.over_noise(after) / problem.over_noise(before))


def _last_name(fit: WholeFit) -> str:
    return str(fit.model.effects[-1].name)


def _guesses(problem: ResponseProblem) -> dict[type[Effect], list[Effect]]:
    """Return initial guesses of effects, by kind."""
    low_hz, high_hz = problem.measured.frequency_hz[[0, -1]]
    middle_hz, count = np.sqrt(low_hz * high_hz), RELAXATIONS
    slow_s = 1.0 / (2.0 * np.pi * np.geomspace(middle_hz, 0.3 * low_hz, count))
    return {
        Creep: [Creep((0.05,) * count, tuple(slow_s))],
        VibrationMode: [
            VibrationMode(2.0 * np.pi * frequency_hz, damping, 0.1)
            for frequency_hz in np.geomspace(low_hz, high_hz, GUESSED_MODES)
            for damping in (0.02, 0.2)],
        Delay: [Delay(delay_s) for delay_s in np.geomspace(0.01, 1.0, 4) / high_hz],
        SensorLag: [SensorLag(lag_s) for lag_s in np.geomspace(0.01, 1.0, 4) / high_hz],
    }


def _diagnosis(problem: ResponseProblem, chosen: ResponseSelection,
               is_reversed: bool) -> ResponseDiagnosis:
    """Assemble the verdict with its numbers and reasons."""
    found = problem.added(chosen.fit)
    effects: list[dict[str, Any]] = [{
        "name": effect.name,
        "error_reduction_percent": reduction_percent(
            problem, problem.fit(problem.parted(chosen.fit, number)[1], STEPS, chosen.fit),
            chosen.fit),
        "parameters": effect.parameters()} for number, effect in enumerate(found)]
    add_deviations(effects, found, problem.covariance(chosen.fit))
    confounded_with = {name: other for name, other in chosen.confounded_with.items()
                       if name not in {effect.name for effect in found}}
    is_explained = problem.over_noise(chosen.fit) <= NEAR_NOISE
    # Even without an effect, other parameters may explain what the given ones do not.
    is_changed = bool(effects) or is_explained and problem.over_noise(chosen.given) > NEAR_NOISE
    final = chosen.fit if is_changed else chosen.given
    faults = [wrong_sign(problem.measured.path)] if is_reversed else []
    return ResponseDiagnosis(
        verdict="unexplained" if not is_explained else "explained" if effects else "none",
        effects=with_stand_ins(effects, problem.extent, {}),
        model=final.model if is_changed else problem.model,
        before=problem.held_out_errors(chosen.given), after=problem.held_out_errors(final),
        noise_floor_um=problem.noise,
        holdout={"source": "frequencies that were not fitted",
                 "samples": int(np.sum(problem.held_out))},
        undecided={name: Undecided(Reason.LIKE_ANOTHER,
                                   f"the response does not distinguish it from {other}")
                   for name, other in confounded_with.items()} | chosen.undecided,
        confounded_with=confounded_with,
        left="" if is_explained else describe_residual(problem, chosen.fit),
        reversed=[fault.recording for fault in faults], left_out=[],
        recording_faults=[fault.document() for fault in faults],
        ceiling=None,
        tried=chosen.tried, measured=problem.measured,
        before_gain=problem.gain(chosen.given), after_gain=problem.gain(final),
    )


def describe_residual(problem: ResponseProblem, fit: WholeFit) -> str:
    """Return a sentence on the residual and its frequencies."""
    energy = np.abs(problem.weighted_error(fit)) ** 2
    frequency_hz = problem.measured.frequency_hz
    low_hz, high_hz = band_of_most(frequency_hz, energy)
    return (
        f"What remains is {problem.over_noise(fit):.3g} times the noise of the response, most of "
        f"it from {low_hz:.3g} to {high_hz:.3g} Hz, largest at "
        f"{frequency_hz[int(np.argmax(energy))]:.4g} Hz.")
