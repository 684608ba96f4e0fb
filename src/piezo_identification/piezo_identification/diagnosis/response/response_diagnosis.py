# SPDX-License-Identifier: BSD-3-Clause
"""What a model lacks to explain a measured frequency response: a comparison of linear effects."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from piezo_common.arrays import ComplexArray
from piezo_common.budget import Budget, spending, while_time_lasts
from piezo_common.progress_part import Progress
from piezo_identification.diagnosis.comparison.criteria import Reason, Undecided
from piezo_identification.diagnosis.evidence.effect_entries import with_stand_ins
from piezo_identification.diagnosis.evidence.recording_faults import wrong_sign
from piezo_identification.diagnosis.response.response_effect_fit import (
    CRITERIA,
    SETTINGS,
    ResponseFit,
    ResponseProblem,
    describe_residual,
    held_out_errors,
    is_convincing,
    is_explained,
    mean_square,
    reduction_percent,
)
from piezo_identification.diagnosis.verdict import Verdict
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_hold import without_hold
from piezo_identification.fitting.dataset import SPLIT
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect
from piezo_models.effects.creep import Creep
from piezo_models.effects.delay import Delay
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode

SLOWEST = 10
"""One frequency in this many, from the lowest, determines the sign of the sensor."""

FEWEST_FREQUENCIES = 4 * SETTINGS.block * SPLIT.held_out
"""Fewest frequencies of a response, of which four blocks are held out."""

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


@dataclass(frozen=True, eq=False)
class ResponseSelection:
    """Result of the comparison of linear effects."""

    fit: ResponseFit
    """Fit with the effects found."""
    effects: list[dict[str, Any]]
    """Entries of the verdict."""
    tried: list[list[tuple[str, float]]]
    """As in `ResponseDiagnosis`."""
    confounded_with: dict[str, str]
    """Effects that the response does not distinguish from one found, and that one."""
    refused: dict[str, Undecided]
    """Effects that are refused, and why."""
    is_explained: bool
    """True if the residual is small enough."""


def diagnose_response(
    model: StageModel, measured: FrequencyResponse,
    progress: Progress = lambda what, fraction: None, budget: Budget | None = None,
) -> ResponseDiagnosis:
    """Find which linear effect a model lacks to explain a frequency response.

    Creep, a further vibration mode, a delay and a sensor lag are compared. Each is fitted to two
    thirds of the frequencies, together with the gain, which the hysteresis does not determine, and
    the model's dynamics within their prior width. They are compared on the other frequencies.
    Nonlinear effects do not show in a response.

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
    """Add linear effects one by one while the gain on held-out frequencies is convincing."""
    progress("the model's dynamics", 0.0)
    start = current = problem.fit_dynamics(problem.as_given())
    found = [start]
    effects: list[dict[str, Any]] = []
    tried: list[list[tuple[str, float]]] = []
    confounded_with: dict[str, str] = {}
    with while_time_lasts("further linear effects"):
        while len(effects) < CRITERIA.most_effects and not is_explained(problem, current):
            # The number of further effects is unknown.
            progress(f"effect {len(effects) + 1}", 1.0 - 0.5 ** len(effects))
            fits = fit_each_candidate(problem, current)
            tried.append([(fit.effects[-1].name, reduction_percent(problem, current, fit))
                          for fit in fits])
            if not fits or not is_convincing(problem, current, fits[0]):
                break
            best = fits[0]
            for other in fits[1:]:
                if reduction_percent(problem, best, other) > -CRITERIA.distinguished_percent:
                    confounded_with[other.effects[-1].name] = best.effects[-1].name
            effects.append({
                "name": best.effects[-1].name,
                "error_reduction_percent": reduction_percent(problem, current, best)})
            current = best
            found.append(current)
    kept, refused = _accepted(problem, found)
    current, effects = found[kept], effects[:kept]
    for entry, effect in zip(effects, current.effects, strict=True):
        entry["parameters"] = effect.parameters()
        confounded_with.pop(entry["name"], None)
    return ResponseSelection(current, effects, tried, confounded_with, refused,
                             is_explained(problem, current))


def _accepted(problem: ResponseProblem,
              found: Sequence[ResponseFit]) -> tuple[int, dict[str, Undecided]]:
    """Return how many of the effects reduce the reported error, and why not the others.

    The comparison weights every frequency by its tolerance, and starts from fitted dynamics. The
    reported errors are those of the gain, and start from the given model.
    """
    before, *after = (held_out_errors(problem, fit)["e_y_percent"]
                      for fit in (problem.as_given(), *found[1:]))
    kept = max((number for number, error in enumerate(after, 1) if error < before), default=0)
    return kept, {
        effect.name: Undecided(
            Reason.WORSE_ON_HELD_OUT,
            f"the error on held-out frequencies would rise from {before:.3g} to {error:.3g} %")
        for effect, error in zip(found[-1].effects[kept:], after[kept:], strict=True)}


def _diagnosis(problem: ResponseProblem, selection: ResponseSelection,
               is_reversed: bool) -> ResponseDiagnosis:
    """Assemble the verdict with its numbers and reasons."""
    given, effects = problem.as_given(), selection.effects
    # Even without an effect, other parameters may explain what the given ones do not.
    is_changed = bool(effects) or selection.is_explained and not is_explained(problem, given)
    final = selection.fit if is_changed else given
    faults = [wrong_sign(problem.measured.path)] if is_reversed else []
    undecided = {name: Undecided(Reason.LIKE_ANOTHER,
                                 f"the response does not distinguish it from {found}")
                 for name, found in selection.confounded_with.items()} | selection.refused
    verdict, left = "explained" if effects else "none", ""
    if not selection.is_explained:
        verdict, left = "unexplained", describe_residual(problem, selection.fit)
    return ResponseDiagnosis(
        verdict=verdict, effects=with_stand_ins(effects, problem.extent, {}),
        model=problem.extended_model(selection.fit) if is_changed else problem.model,
        before=held_out_errors(problem, given), after=held_out_errors(problem, final),
        noise_floor_um=problem.noise,
        holdout={"source": "frequencies that were not fitted",
                 "samples": int(np.sum(~problem.estimation))},
        undecided=undecided,
        confounded_with=selection.confounded_with, left=left,
        reversed=[fault.recording for fault in faults], left_out=[],
        recording_faults=[fault.document() for fault in faults],
        ceiling=None,
        tried=selection.tried, measured=problem.measured,
        before_gain=problem.gain(given), after_gain=problem.gain(final),
    )


def fit_each_candidate(problem: ResponseProblem, current: ResponseFit) -> list[ResponseFit]:
    """Fit every candidate in addition to the effects found, the best on held-out data first."""
    found = {type(effect) for effect in current.effects}
    fits = []
    for kind, guesses in _guesses(problem).items():
        if kind in found and not kind.several:
            continue
        fitted = [problem.fit_last_effect(current, guess) for guess in guesses]
        best = min(fitted, key=lambda fit: mean_square(problem, fit, problem.estimation))
        fits.append(problem.fit_dynamics(best))
    return sorted(fits, key=lambda fit: mean_square(problem, fit))


def _guesses(problem: ResponseProblem) -> dict[type[Effect], list[Effect]]:
    """Return initial guesses of effects, by kind."""
    low_hz, high_hz = problem.measured.frequency_hz[[0, -1]]
    middle_hz, count = np.sqrt(low_hz * high_hz), RELAXATIONS
    slow_s = 1.0 / (2.0 * np.pi * np.geomspace(middle_hz, 0.3 * low_hz, count))
    return {
        Creep: [Creep((0.05,) * count, tuple(slow_s))],
        VibrationMode: [
            VibrationMode(2.0 * np.pi * frequency_hz, damping, 0.1)
            for frequency_hz in np.geomspace(*problem.mode_range_hz, GUESSED_MODES)
            for damping in (0.02, 0.2)],
        Delay: [Delay(delay_s) for delay_s in np.geomspace(0.01, 1.0, 4) / high_hz],
        SensorLag: [SensorLag(lag_s) for lag_s in np.geomspace(0.01, 1.0, 4) / high_hz],
    }
