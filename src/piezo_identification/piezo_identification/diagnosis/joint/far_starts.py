# SPDX-License-Identifier: BSD-3-Clause
"""Fits of effects that the model has made up for: the model makes way first.

The model's parameters have made up for most of an effect that was there all along: beside them it
looks smaller than it is, and a fit from there ends with too little of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from piezo_identification.fitting.joint_fit import JointFit, JointProblem
from piezo_models.effects import Effect


@dataclass(frozen=True)
class FarSettings:
    """How long fits go on.

    Attributes
    ----------
    turns : int
        In which fits go on at most, each of several steps.
    hopeful : float
        A fit goes on while it is behind the best by less than so many times the evidence that its
        last step gained.
    """

    turns: int = 5
    hopeful: float = 3.0


SETTINGS = FarSettings()


def from_afar(problem: JointProblem, beside: JointFit, guesses: Sequence[Effect],
              nearby: JointFit) -> JointFit:
    """Return the best of fits of an effect: as it is, and from where the model makes way.

    Parameters
    ----------
    beside : JointFit
        Of the model and what it has beside the effect.
    guesses : sequence of piezo_models.effects.effect.Effect
        Of the effect; the fit as it is began from the first.
    nearby : JointFit
        As it is.
    """
    held = _held(problem, beside, guesses[1:])
    if held is not None and may_lead(held, nearby):
        nearby = _better(problem.fit(held.effects, begun=held), nearby)
    fit = _taken_out(problem, beside, guesses)
    if fit is not None:
        for _ in range(SETTINGS.turns):
            if fit.has_converged or not may_lead(fit, nearby):
                break
            fit = problem.fit(fit.effects, begun=fit)
        nearby = _better(fit, nearby)
    return nearby


def _better(*fits: JointFit) -> JointFit:
    return min(fits, key=lambda fit: fit.against)


def may_lead(fit: JointFit, best: JointFit) -> bool:
    """Tell whether a fit that goes on may yet have less evidence against it than the best."""
    return fit.against - SETTINGS.hopeful * fit.gain < best.against


def _held(problem: JointProblem, beside: JointFit, guesses: Sequence[Effect]) -> JointFit | None:
    """Fit the model by one step beside each guess, which stays as it is, and return the best."""
    fits = [problem.fit(beside.effects, begun=beside, held=(guess,)) for guess in guesses]
    return _better(*fits) if fits else None


def _taken_out(problem: JointProblem, beside: JointFit,
               guesses: Sequence[Effect]) -> JointFit | None:
    """Take the best guess out of the hysteresis that has it, and fit both from there."""
    model, found = problem.dataset.model, []
    for guess in guesses:
        ahead = guess.hysteresis_ahead(model.hysteresis)
        if ahead is not None:
            made_way = replace(model, hysteresis=ahead)
            effects = (*beside.effects, guess)
            found.append((problem.against(made_way, effects), made_way, effects))
    if not found:
        return None
    _, made_way, effects = min(found, key=lambda entry: entry[0])
    return problem.about(made_way).fit(effects)
