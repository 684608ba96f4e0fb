# SPDX-License-Identifier: BSD-3-Clause
"""Fits of effects for which the model's parameters have compensated.

The model's parameters compensate for most of an effect that was present at the identification. The
effect then looks smaller than it is, and a fit from there underestimates it. These fits therefore
change the model first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from piezo_identification.fitting.joint_fit import JointFit, JointProblem
from piezo_models.effects import Effect


@dataclass(frozen=True)
class FarSettings:
    """Limits of continued fits."""

    turns: int = 5
    """Largest number of continued fits, each of several steps."""
    hopeful: float = 3.0
    """A fit is continued if its deficit of evidence is less than this multiple of the gain of its
    last step."""


SETTINGS = FarSettings()


def from_afar(problem: JointProblem, simpler: JointFit, guesses: Sequence[Effect],
              nearby: JointFit) -> JointFit:
    """Return the best fit of an effect: the given one, or one that starts from a changed model.

    Parameters
    ----------
    simpler : JointFit
        Fit of the model without the effect.
    guesses : sequence of piezo_models.effects.effect.Effect
        Initial guesses of the effect; the given fit started from the first.
    nearby : JointFit
        Given fit of the effect.
    """
    held = _held(problem, simpler, guesses[1:])
    if held is not None and may_lead(held, nearby):
        nearby = _better(problem.fit(held.effects, begun=held), nearby)
    fit = _taken_out(problem, simpler, guesses)
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
    """Return whether a fit may still become better than the best when it is continued."""
    return fit.against - SETTINGS.hopeful * fit.gain < best.against


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
