# SPDX-License-Identifier: BSD-3-Clause
"""Search for the structure of a model: one part more, less or elsewhere, all else fitted anew."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from piezo_identification.fitting.whole_model import WholeFit, WholeModel
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import CreepDynamics


@dataclass(frozen=True)
class SearchSettings:
    """How far the search goes.

    Attributes
    ----------
    steps : int
        Of the first fit, and of the last.
    screening_steps : int
        Of each alternative.
    followed_steps : int
        Further steps of an alternative that these have made promising.
    followed : int
        Alternatives of each round that are followed.
    rounds : int
        Changes of the structure at most.
    promise : float
        Evidence, as a natural logarithm, by which an alternative may be behind then; one that is
        further behind is not tried again.
    above_noise : float
        What has to be left of the fastest recording, over its noise, for a mode to be sought there.
    wrong : float
        What is left of the fastest recording, over its noise, from which every alternative gets as
        many steps as the first fit.
    highest : float
        Frequency of such a mode at most, over that of the samples.
    worse : float
        The same by which rows that are held out may be worse: chance alone.
    first_lag : float
        Least time constant, in sample periods, from which a new lag is fitted.
    """

    steps: int = 12
    screening_steps: int = 2
    followed_steps: int = 4
    followed: int = 2
    rounds: int = 4
    promise: float = 100.0
    above_noise: float = 1.2
    highest: float = 0.3
    wrong: float = 3.0
    worse: float = 0.5
    first_lag: float = 0.5


SETTINGS = SearchSettings()


@dataclass(frozen=True, eq=False)
class Structure:
    """A structure to fit from some values.

    Attributes
    ----------
    change : str
        What it has more or less than the one before.
    model : StageModel
    delay_s : float or None
    """

    change: str
    model: StageModel
    delay_s: float | None


def search(problem: WholeModel, given: StageModel,
           report: Callable[[str, float], object] = lambda *_: None,
           ) -> tuple[WholeFit, list[tuple[str, WholeFit]]]:
    """Fit the whole model, and change its structure as long as that has more evidence.

    Parameters
    ----------
    problem : WholeModel
    given : StageModel
        That was identified step by step.
    report : callable
        Called with what is tried, and the fraction done, before each.

    Returns
    -------
    best : WholeFit
        Of all that were tried, the given model included.
    tried : list of (str, WholeFit)
        All that were tried, in their order.
    """
    before = problem.as_it_is(given)
    tried = [("step by step", before)]
    report("everything together", 0.0)
    # The first fit tells how many errors are independent, the second one counts them so.
    problem.count_as(problem.fit(given, before.delay_s, SETTINGS.steps))
    fitted = problem.fit(given, before.delay_s, SETTINGS.steps)
    tried.append(("everything together", fitted))
    best, refuted = fitted if is_better(fitted, before) else before, set[str]()
    for turn in range(SETTINGS.rounds):
        screened = []
        # What is clearly wrong is far from where it would be right.
        is_wrong = problem.fastest_over_noise(best) > SETTINGS.wrong
        steps = SETTINGS.steps if is_wrong else SETTINGS.screening_steps
        for structure in structures(problem, best):
            if structure.change in refuted:
                continue
            report(structure.change, (turn + 1) / (SETTINGS.rounds + 1))
            fit = problem.fit(structure.model, structure.delay_s, steps, best.density_changes)
            screened.append((structure.change, fit))
        screened.sort(key=lambda entry: -entry[1].evidence_over(best))
        followed = []
        for change, fit in screened[: SETTINGS.followed]:
            if not fit.has_converged and fit.evidence_over(best) > -SETTINGS.promise:
                fit = problem.again(fit, SETTINGS.followed_steps)
            followed.append((change, fit))
        tried += followed + screened[SETTINGS.followed :]
        refuted |= {change for change, fit in screened
                    if fit.evidence_over(best) < -SETTINGS.promise}
        better = [fit for _, fit in followed
                  if is_better(fit, best) and has_modes_in_band(problem, fit)]
        if not better:
            break
        best = max(better, key=lambda fit: fit.evidence_over(before))
    if best is not before and not best.has_converged:
        last = problem.again(best, SETTINGS.steps)
        tried.append(("everything together, on from there", last))
        best = last if is_better(last, best) else best
    return best, tried


def is_better(fit: WholeFit, other: WholeFit) -> bool:
    """Tell whether a fit has more evidence than another, and held-out rows do not object."""
    return fit.evidence_over(other) > 0.0 and fit.held_out_over(other) > -SETTINGS.worse


def has_modes_in_band(problem: WholeModel, fit: WholeFit) -> bool:
    """Tell whether all modes beside the others are slow enough for the samples to show them."""
    highest_rad_per_s = 2.0 * np.pi * SETTINGS.highest / problem.sample_period_s
    return all(effect.frequency_rad_per_s <= highest_rad_per_s for effect in fit.model.effects
               if isinstance(effect, VibrationMode))


def structures(problem: WholeModel, fit: WholeFit) -> Iterator[Structure]:
    """Yield the structures that differ from a fitted one by one part.

    Parameters
    ----------
    problem : WholeModel
    fit : WholeFit

    Yields
    ------
    Structure
    """
    yield from _with_less(fit)
    yield from _elsewhere(fit)
    yield from _with_more(problem, fit)


def _with_less(fit: WholeFit) -> Iterator[Structure]:
    model, delay_s = fit.model, fit.delay_s
    if delay_s is not None:
        yield Structure("without the delay", *_later(model, None, delay_s))
    for place, effect in enumerate(model.effects):
        yield Structure(f"without the {effect.name}", _without(model, place), delay_s)
    if model.dynamics.time_constant_s > 0.0:
        yield Structure("without the electric time constant", *_later(
            _electric(model, 0.0), delay_s, model.dynamics.time_constant_s))
    poles, zeros = model.creep.poles_rad_per_s, model.creep.zeros_rad_per_s
    if len(poles) > 1:
        least = int(np.argmin(np.log(zeros) - np.log(poles)))
        creep = CreepDynamics((*poles[:least], *poles[least + 1 :]),
                              (*zeros[:least], *zeros[least + 1 :]))
        yield Structure("without a pair of the creep", replace(model, creep=creep), delay_s)


def _elsewhere(fit: WholeFit) -> Iterator[Structure]:
    """Yield a lag on the other side of the hysteresis."""
    model, delay_s = fit.model, fit.delay_s
    behind_s = model.dynamics.time_constant_s
    ahead = [place for place, effect in enumerate(model.effects) if type(effect) is AmplifierLag]
    if behind_s > 0.0 and not ahead:
        yield Structure(
            "its electric lag in front of the hysteresis",
            _with(_electric(model, 0.0), AmplifierLag(behind_s)), delay_s)
    for place in ahead:
        moved_s = model.effects[place].parameters()["time_constant_s"]
        yield Structure(
            "its amplifier's lag behind the hysteresis",
            _electric(_without(model, place), behind_s + moved_s), delay_s)


def _with_more(problem: WholeModel, fit: WholeFit) -> Iterator[Structure]:
    model, delay_s = fit.model, fit.delay_s
    kinds = {type(effect) for effect in model.effects}
    if model.dynamics.is_static and not kinds:
        return  # Only slow recordings were given, which show nothing fast.
    if delay_s is None:
        yield Structure("with a delay", model, 0.0)
    # Half of a lag that is there may be another's.
    lag_s = max(SETTINGS.first_lag * problem.sample_period_s,
                0.5 * model.dynamics.time_constant_s)
    if AmplifierLag not in kinds:
        earlier, earlier_s = _later(model, delay_s, -lag_s)
        yield Structure("with an amplifier's lag", _with(earlier, AmplifierLag(lag_s)), earlier_s)
    if SensorLag not in kinds:
        earlier, earlier_s = _later(model, delay_s, -lag_s)
        yield Structure("with a sensor's lag", _with(earlier, SensorLag(lag_s)), earlier_s)
    if model.dynamics.time_constant_s == 0.0:
        earlier, earlier_s = _later(model, delay_s, -lag_s)
        yield Structure("with an electric time constant", _electric(earlier, lag_s), earlier_s)
    if problem.fastest_over_noise(fit) < SETTINGS.above_noise:
        return
    shown = min(problem.evidence(fit), key=lambda evidence: evidence.sample_period_s)
    for mode in VibrationMode.starts(shown)[:1]:
        yield Structure("with a mode at the peak of what is left", _with(model, mode), delay_s)


def _later(model: StageModel, delay_s: float | None,
           by_s: float) -> tuple[StageModel, float | None]:
    """Return a model and its delay, one of whose lags is longer by some time.

    What a fit begins from then comes as late as before. Where no lag can be so much shorter, all
    stay as they are.
    """
    for place, effect in enumerate(model.effects):
        if isinstance(effect, AmplifierLag) and effect.time_constant_s + by_s > 0.0:
            longer = AmplifierLag(effect.time_constant_s + by_s)
            return replace(model, effects=(
                *model.effects[:place], longer, *model.effects[place + 1 :])), delay_s
    electric_s = model.dynamics.time_constant_s
    if electric_s > 0.0 and electric_s + by_s > 0.0:
        return _electric(model, electric_s + by_s), delay_s
    return model, None if delay_s is None else delay_s + by_s


def _with(model: StageModel, effect: Effect) -> StageModel:
    return replace(model, effects=(*model.effects, effect))


def _without(model: StageModel, place: int) -> StageModel:
    return replace(model, effects=(*model.effects[:place], *model.effects[place + 1 :]))


def _electric(model: StageModel, time_constant_s: float) -> StageModel:
    return replace(model, dynamics=replace(model.dynamics, time_constant_s=time_constant_s))
