# SPDX-License-Identifier: BSD-3-Clause
"""Search for the structure of a model: change one part at a time and refit all parameters."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from piezo_common.arrays import FloatArray
from piezo_common.budget import while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_common.side_by_side import side_by_side
from piezo_identification.fitting.least_damped_modes import with_least_damped_modes
from piezo_identification.fitting.whole_model import WIDE_PRIOR, WholeFit, WholeModel
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.band_limited_voltage import BandLimitedVoltage
from piezo_models.effects.bouc_wen_hysteresis import BoucWenHysteresis
from piezo_models.effects.coupled_mode import CoupledMode, modes_in_parallel, modes_in_series
from piezo_models.effects.curved_bouc_wen_hysteresis import CurvedBoucWenHysteresis
from piezo_models.effects.effect import with_fitted_values
from piezo_models.effects.second_order_amplifier import SecondOrderAmplifier
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics


@dataclass(frozen=True)
class SearchSettings:
    """Limits of the search."""

    steps: int = 12
    """Largest number of steps of the fit from each start and of the last fit."""
    screening_steps: int = 2
    """Largest number of steps for each structure that is tried; only one if that leaves it far
    behind."""
    followed_steps: int = 6
    """Largest number of further steps for a promising structure."""
    followed: int = 2
    """Number of structures per round that get further steps."""
    rounds: int = 10
    """Largest number of changes of the structure."""
    promise: float = 100.0
    """Largest deficit of log-evidence with which a structure is followed, or tried again after a
    change that gained as much."""
    promise_of_start: float = 1000.0
    """Largest deficit with which a start with another kind of amplifier or with a line is
    followed, before and after the search from the best start: its own search may add as much."""
    promise_before_loops: float = 5000.0
    """Largest deficit with which the loops are estimated again with a start, before that is done
    with the best one."""
    promise_before_pasts: float = 3000.0
    """Largest deficit with which the pasts are sought behind a Bouc-Wen hysteresis: without them,
    all recordings begin at rest."""
    chance: float = 3.0
    """Largest loss of log-likelihood on held-out rows that is attributed to chance."""
    distinct: float = 1.0
    """Largest gain of log-evidence with which a structure of as many parameters does not replace
    another: the recordings do not tell the two apart, and other motion may."""
    worthwhile: float = 0.01
    """Smallest gain of log-evidence for each independent error with which a search goes on if a
    residual is not noise. It reduces the RMS residual by a hundredth."""
    worthwhile_near_noise: float = 0.005
    """The same if each residual is nearly noise."""
    modes_less: int = 2
    """Number of modes per round, the least important ones, that are removed on trial."""
    above_noise: float = 1.05
    """Smallest residual of a recording, relative to its noise, for which further parts are
    tried."""
    surely_at_noise: float = 1.01
    """Residual of each recording, relative to its noise, below which no other start is tried. A lag
    at the wrong place may leave hardly more, and be far off on other motion."""
    wrong: float = 3.0
    """Residual of the fastest recording, relative to its noise, above which every structure gets as
    many steps as the first fit."""
    far: float = 30.0
    """Residual of recorded loops, relative to their noise, above which another kind of hysteresis
    is tried before the loops are estimated again."""
    highest: float = 0.3
    """Highest frequency of a mode, relative to the sampling frequency."""
    slowest: float = 1e-3
    """Lowest frequency of a mode, relative to the highest; slower ones are creep."""
    most_damped: float = 0.5
    """Largest damping ratio of a mode that is kept in the simplest start."""
    least_in_phase: float = 0.3
    """Sum of the participations of modes, relative to the sum of their magnitudes, below which they
    are not treated as modes of one structure in phase."""
    most_uncoupled: float = 0.3
    """Largest damping ratio of a mode of a structure."""
    least_participation: float = 0.01
    """Smallest participation, relative to the largest, of a mode beside a new amplifier of second
    order."""
    first_lag: float = 0.5
    """Smallest initial time constant of a new lag, in sample periods."""
    faster_creep: float = 8.0
    """Rate of a new creep pair, relative to the fastest rate."""
    first_pairs: int = 4
    """Number of creep pairs that are added together to a model without any."""
    first_creep: float = 0.005
    """Initial size of each of them, relative to the displacement."""
    slowest_creep: float = 3.0
    """Rate of the slowest creep times the longest duration above which slower creep is tried."""
    widest_gap: float = 12.0
    """Ratio of neighbouring creep rates above which a start gets another pair between them."""


SETTINGS = SearchSettings()

FLAT = 2**-0.5
"""Initial quality factor of an amplifier, whose amplitude is then flat over frequency. Loops
that were estimated without overshoot keep a fit from finding any."""

BOUC_WEN = "a Bouc-Wen hysteresis"

MODES_IN_SERIES = "its modes in series"
"""Tried again after a part was left out: beside a part that is not needed, the participations of
parallel modes may differ from those of modes in series."""

Tried = tuple[str, WholeFit]
"""Description of a change of the structure, and the fit with it."""

Begun = tuple[WholeModel, WholeFit]
"""A fitted start, preceded by the problem with its loops."""


@dataclass(frozen=True, eq=False)
class Structure:
    """A structure to fit, with initial values."""

    change: str
    """Difference from the structure before."""
    model: StageModel
    delay_s: float | None

    is_far: bool = False
    """True if its values are far from the optimum: it then gets more steps before it is judged."""


def begun(problem: WholeModel, given: StageModel, delay_s: float | None,
          report: Callable[[str, float], object] = lambda *_: None,
          is_asked_for: Callable[[StageModel], bool] = lambda _: True,
          with_new_loops: Callable[[WholeFit], WholeModel] | None = None,
          ) -> tuple[list[Begun], list[Tried]]:
    """Fit the whole model from several starts.

    `given` is the model identified step by step. `delay_s` is its delay, negative if its rows are
    read later than stated in the problem. `report` is called with a description and the fraction
    done before each fit, and `is_asked_for` returns whether a model may be tried.

    `with_new_loops` returns the problem with loops estimated again with a fitted model. The loops
    of the given model compensate for the errors of its creep and dynamics, and a fit with other
    dynamics takes long to correct them. Those of the first start are used for the others, because
    the starts differ little at the speed of the loops. An amplifier of second order has its own:
    its overshoot also acts on slow voltages.

    Return the fits that may be continued, each with its problem, and all fits in the order they
    were made.
    """
    best = before = problem.fit(given, delay_s, 0)
    tried = [("step by step", before)]
    found = [(problem, before)]
    clean = list(starts(problem, given, delay_s, with_new_loops is not None))
    between = list(between_rows(problem, given, delay_s))

    def is_sought(structure: Structure) -> bool:
        check_cancelled()
        return is_asked_for(structure.model) and not is_at_noise(
            problem, best, SETTINGS.surely_at_noise)

    def add(where: WholeModel, structure: Structure,
            density_changes: FloatArray | None = None) -> WholeFit:
        nonlocal best
        report(structure.change, len(tried) / (len(tried) + len(clean) + len(between)))
        fit = where.fit(structure.model, structure.delay_s, SETTINGS.steps, density_changes)
        tried.append((structure.change, fit))
        found.append((where, fit))
        best = fit if is_better(fit, best) else best
        return fit

    with while_time_lasts("other starts of the fit"):
        if is_asked_for(given):
            add(problem, Structure("everything together", given, delay_s))
        where = problem
        for structure in filter(is_sought, clean):
            if where is problem and with_new_loops is not None:
                report(structure.change, 0.0)
                # The first estimate is as wrong as the dynamics before any fit.
                where, structure = _with_own_loops(
                    problem, structure, with_new_loops, (0, SETTINGS.followed_steps))
                for amplified in filter(is_sought, _with_second_order_amplifier(
                        problem, add(where, structure))):
                    behind, amplified = _with_own_loops(where, amplified, with_new_loops, (0,))
                    fit = add(behind, amplified)
                    # A delay compensates for an amplifier that is yet to be found.
                    if (delay_s or 0.0) > 0.0:
                        add(behind, Structure(f"{amplified.change}, and a delay", fit.model, 0.0),
                            fit.density_changes)
            else:
                add(where, structure)
        for structure in filter(is_sought, between):
            if problem.fastest_over_noise(best) > SETTINGS.wrong:
                add(problem, structure)
    return [(where, fit) for where, fit in found if fit is not before or fit is best], tried


def _with_own_loops(
    problem: WholeModel, structure: Structure, with_new_loops: Callable[[WholeFit], WholeModel],
    steps_before: Sequence[int],
) -> tuple[WholeModel, Structure]:
    """Return the problem with loops estimated with a start, and the start as it is then.

    Before each estimate, the start is fitted with some steps.
    """
    for steps in steps_before:
        fit = problem.fit(structure.model, structure.delay_s, steps)
        structure = replace(structure, model=fit.model, delay_s=fit.delay_s)
        problem = with_new_loops(fit)
    return problem, structure


def fitted_with_bouc_wen(
    problem: WholeModel, best: WholeFit, is_plain: bool = False,
) -> tuple[WholeModel, WholeFit, list[Tried]]:
    """Fit a Bouc-Wen hysteresis in place of that of a fitted model.

    No Preisach hysteresis has loops that drift and do not close. The most general form comes first:
    its growth depends on the voltage, and a curve is beside it. If it is promising, the pasts of
    the recordings are sought with the fitted equation until that is no longer worthwhile. Modes
    that stand for errors of the loops would hide their shape, so a start with the loudest mode
    alone follows. If that leaves more than little above the noise, the plain forms come last, in
    front of a line and of a curve; with `is_plain`, the result is one of these.

    `best` is a fit of the given problem. Return the problem of the best fit with the equation, that
    fit, even if the given one is better, and all fits in the order they were made.
    """
    tried = list[Tried]()

    def fitted(form: str, where: WholeModel, start: StageModel, delay_s: float | None,
               rival: WholeFit, promise: float) -> Begun:
        fit = _raced(where, Structure(form, start, delay_s), rival, SETTINGS.steps, None, promise)
        tried.append((form, fit))
        for _ in range(SETTINGS.rounds):
            if is_at_noise(where, fit) or fit.evidence_over(rival) < -promise:
                break
            again = where.with_hysteresis(fit.delayed_model, WIDE_PRIOR)
            closer = again.fit(fit.model, fit.delay_s, SETTINGS.steps)
            tried.append((f"{form}, pasts sought again", closer))
            if not is_better(closer, fit):
                break
            # Each adds less than the one before.
            promise = closer.evidence_over(fit)
            where, fit = again, closer
            if promise < SETTINGS.worthwhile * fit.counts.sum():
                break
        return where, fit

    fits = list[Begun]()
    for model, what in _with_fewer_modes(problem, best.model):
        if not any(is_at_noise(*each, SETTINGS.wrong) for each in fits):
            where, start = problem.with_bouc_wen(model)
            fits.append(fitted(f"{BOUC_WEN}{what}", where, start, best.delay_s, best,
                               SETTINGS.promise_before_pasts))
    leader = best_of([fit for _, fit in fits])
    where = next(where for where, fit in fits if fit is leader)
    if not is_plain and is_at_noise(where, leader, SETTINGS.wrong):
        return where, leader, tried  # The search tries the plain form in its place.
    start = _with_plain_bouc_wen(leader.model)
    rival, promise = (best, SETTINGS.promise_before_pasts) if is_plain else (
        leader, SETTINGS.promise)
    plain = [fitted(f"{BOUC_WEN} that is equal at all voltages{behind}", with_behind, start,
                    leader.delay_s, rival, promise)
             for behind, with_behind in (("", where), (", a curve", where.with_curve(start)))]
    fits = plain if is_plain else [*fits, *plain]
    leader = best_of([fit for _, fit in fits])
    return next(where for where, fit in fits if fit is leader), leader, tried


def _with_plain_bouc_wen(model: StageModel) -> StageModel:
    """Return a model whose Bouc-Wen hysteresis is equal at all voltages."""
    names = [each.name for each in fields(BoucWenHysteresis)]
    return replace(model, effects=tuple(
        BoucWenHysteresis(**{name: getattr(effect, name) for name in names})
        if isinstance(effect, BoucWenHysteresis) else effect for effect in model.effects))


def _with_general_bouc_wen(model: StageModel) -> StageModel:
    """Return a model whose plain Bouc-Wen hysteresis may differ with the voltage."""
    middle_v = 0.5 * (model.hysteresis.voltage_min_v + model.hysteresis.voltage_max_v)
    return replace(model, effects=tuple(
        CurvedBoucWenHysteresis(**effect.parameters(), middle_v=middle_v)
        if type(effect) is BoucWenHysteresis else effect for effect in model.effects))


def _with_fewer_modes(problem: WholeModel, model: StageModel) -> Iterator[tuple[StageModel, str]]:
    """Yield a model, and with the loudest of several modes alone, with what to add to its name."""
    yield model, ""
    modes, others = _modes_and_others(model)
    if len(modes) + len(model.dynamics.mode_frequencies_rad_per_s) > 1:
        yield replace(model, effects=others, dynamics=replace(
            loudest_mode(model, problem.sample_period_s),
            time_constant_s=model.dynamics.time_constant_s)), ", the loudest mode"


def best_of(fits: Sequence[WholeFit]) -> WholeFit:
    """Return the best of some fits; of equals, the first one."""
    return reduce(lambda best, fit: fit if is_better(fit, best) else best, fits)


def promising(fits: Sequence[WholeFit]) -> list[WholeFit]:
    """Return the best fit, and the best one with another amplifier if it is not far behind.

    Which one will end up better is not known before the search. If they are alike, the amplifier of
    second order comes first: the search can make an amplifier simpler, but finds no other one once
    the fast rows are explained.
    """
    best = best_of(fits)
    rivals = [fit for fit in fits
              if has_amplifier(fit) != has_amplifier(best) and is_promising(fit, best)]
    if not rivals:
        return [best]
    rival = best_of(rivals)
    is_alike = rival.evidence_over(best) > -SETTINGS.promise
    return [rival, best] if has_amplifier(rival) and is_alike else [best, rival]


def is_promising(start: WholeFit, best: WholeFit) -> bool:
    """Return whether a start may end up with more evidence than the best fit."""
    return start.evidence_over(best) > -SETTINGS.promise_of_start


def has_amplifier(fit: WholeFit) -> bool:
    """Return whether a fit has a second-order amplifier, which no step-by-step fit finds."""
    return any(isinstance(effect, SecondOrderAmplifier) for effect in fit.model.effects)


def searched(problem: WholeModel, best: WholeFit,
             report: Callable[[str, float], object] = lambda *_: None,
             is_asked_for: Callable[[StageModel], bool] = lambda _: True,
             ) -> tuple[WholeFit, list[Tried]]:
    """Change the structure of a fitted model as long as the evidence increases.

    `best` is a fit of the given problem. Return the fit with the most evidence, and all fits in the
    order they were made.
    """
    refuted, tried = set[str](), list[Tried]()
    screened, is_simpler = list[Tried](), False
    with while_time_lasts("further changes of the structure") as search:
        for turn in range(SETTINGS.rounds):
            screened = []
            check_cancelled()
            if not best.has_converged:
                # Otherwise others would win only because of their additional steps.
                again = problem.again(best, SETTINGS.followed_steps)
                tried.append(("the same, on from there", again))
                best = again if is_better(again, best) else best
            if is_simpler:
                refuted.discard(MODES_IN_SERIES)
            _screen(problem, best, [
                structure for structure in (
                    _with_less(best) if is_simpler else structures(problem, best))
                if structure.change not in refuted and is_asked_for(structure.model)],
                screened, _of_round(report, turn))
            screened.sort(key=lambda entry: -entry[1].evidence_over(best))
            followed = []
            for change, fit in screened[: SETTINGS.followed]:
                if not fit.has_converged and fit.evidence_over(best) > -SETTINGS.promise:
                    fit = problem.again(fit, SETTINGS.followed_steps)
                followed.append((change, fit))
            screened[: SETTINGS.followed] = followed
            tried += screened
            better = _better(problem, followed, best)
            if not better:
                break
            # What added nothing before a part was left out adds nothing after it.
            is_simpler = all(
                fit.numbers < best.numbers for fit in _better(problem, screened, best))
            before, best = best, max(better, key=lambda fit: fit.evidence_over(best))
            # What lost more than this change gains is not made up for by it.
            gain = min(best.evidence_over(before), SETTINGS.promise)
            refuted |= {change for change, fit in screened if fit.evidence_over(before) < -gain}
            if is_pointless(problem, before, best):
                break
        problem.about_here()
        last = problem.again(best, SETTINGS.steps)
        tried.append(("the same, on from there", last))
        best = last if is_better(last, best) else best
    if search.was_cut:
        tried += [entry for entry in screened if entry not in tried]
        best = max([best, *_better(problem, screened, best)],
                   key=lambda fit: fit.evidence_over(best))
    return best, tried


def _screen(problem: WholeModel, best: WholeFit, listed: Sequence[Structure],
            screened: list[Tried], report: Callable[[str, float], object]) -> None:
    """Fit structures with a few steps each, and append each fit to a list once it is done."""
    # Structures near a clearly wrong model are far from their optimum.
    is_wrong = problem.fastest_over_noise(best) > SETTINGS.wrong

    def fit(structure: Structure) -> None:
        steps = (SETTINGS.steps if is_wrong else SETTINGS.followed_steps if structure.is_far
                 else SETTINGS.screening_steps)
        screened.append((structure.change, _raced(
            problem, structure, best, steps, best.density_changes)))

    def reported(number: int) -> None:
        report(listed[number].change, number / len(listed))

    problem.about(best)
    # The first fit computes what the others share.
    side_by_side(fit, listed[:1], reported)
    side_by_side(fit, listed[1:], lambda number: reported(number + 1))


def _raced(problem: WholeModel, structure: Structure, best: WholeFit, steps: int,
           density_changes: FloatArray | None = None,
           promise: float = SETTINGS.promise) -> WholeFit:
    """Fit a structure, but end if it would not come near the best fit with gains as the last."""
    fit, left = problem.fit(structure.model, structure.delay_s, 1, density_changes), steps - 1
    while left > 0 and not fit.has_converged and (
            -fit.evidence_over(best) < promise + left * fit.gain):
        more = min(left, SETTINGS.screening_steps)
        fit, left = problem.again(fit, more), left - more
    return fit


def _of_round(report: Callable[[str, float], object], turn: int) -> Callable[[str, float], object]:
    """Return the progress callback of a round; the number of further rounds is unknown."""
    return lambda what, part: report(what, 1.0 - 0.5 ** (turn + part))


def _better(problem: WholeModel, tried: Sequence[Tried], best: WholeFit) -> list[WholeFit]:
    """Return the fits that are better than the best so far, with all modes within the band."""
    return [fit for _, fit in tried
            if is_better(fit, best) and has_modes_in_band(problem, fit)
            and fit.evidence_over(best) > SETTINGS.distinct * (fit.numbers == best.numbers)]


def starts(problem: WholeModel, given: StageModel, delay_s: float | None,
           is_loop_recorded: bool) -> Iterator[Structure]:
    """Yield alternative starts of the search.

    They contain the ringing modes and a lag on one side of the hysteresis. A search without the
    hysteresis describes part of the loops as dynamics, which step-by-step changes cannot undo.
    """
    given = _with_modes_in_parallel(given)
    ringing = [effect for effect in given.effects
               if isinstance(effect, VibrationMode) and _rings(problem, effect)]
    if given.dynamics.is_static and not ringing:
        # Loops compensate for creep that the step-by-step estimate did not find.
        creep = _creep_as_far_as(_without_gaps(given.creep), 1.0 / problem.sample_period_s)
        if is_loop_recorded and creep != given.creep:
            yield Structure("creep as fast as the rows", replace(given, creep=creep), delay_s)
        return
    others = tuple(effect for effect in given.effects
                   if not isinstance(effect, VibrationMode | AmplifierLag | SensorLag))
    lag_s = next((effect.time_constant_s for effect in given.effects
                  if type(effect) is AmplifierLag), problem.sample_period_s)
    modes = apart(ringing)
    bare = replace(_electric(given, 0.0), creep=_creep_up_to(given.creep, ringing))
    effects = (*_in_phase(modes), *others)
    what = f"{len(modes)} modes that ring"
    yield Structure(f"{what}, with an amplifier's lag", replace(
        bare, effects=(AmplifierLag(lag_s), *effects)), delay_s)
    if len(modes) > 1:
        # Modes of a wrong order stand for errors of the loops, and are hard to remove again.
        loudest = loudest_mode(given, problem.sample_period_s)
        mode = CoupledMode(
            loudest.mode_frequencies_rad_per_s[0], loudest.damping_ratios[0], participation=1.0)
        yield Structure("its loudest mode alone, with an amplifier's lag", replace(
            bare, effects=(AmplifierLag(lag_s), mode, *others)), delay_s or 0.0)
    if any(isinstance(effect, VibrationMode) for effect in given.effects):
        yield Structure(f"{what}, with an electric lag", replace(
            _electric(bare, lag_s), effects=effects), delay_s)


def _with_second_order_amplifier(problem: WholeModel, fit: WholeFit) -> Iterator[Structure]:
    """Yield a fitted start with an amplifier of second order, in place of its lag and delay.

    Of its modes, those that ring and move the stage remain: others may stand for creep, for errors
    of the loops, or for the amplifier itself. The phases of those that remain are part of its
    delay. Only recorded loops tell it from a mode.
    """
    modes, others = _modes_and_others(fit.model)
    largest = max((abs(mode.participation) for mode in modes), default=0.0)
    clear = [mode for mode in modes
             if mode.damping_ratio < SETTINGS.most_uncoupled and _rings(problem, mode)
             and abs(mode.participation) > SETTINGS.least_participation * largest]
    if clear or not modes:
        late_s = (max(fit.delay_s or 0.0, 0.0) + _lag_of_coupled_modes(clear) + sum(
            effect.time_constant_s for effect in others if isinstance(effect, AmplifierLag)))
        late_s = max(late_s, SETTINGS.first_lag * problem.sample_period_s)
        others = tuple(effect for effect in others if not isinstance(effect, AmplifierLag))
        yield Structure(f"{len(clear)} modes in phase, an amplifier of second order", replace(
            fit.model, creep=_creep_up_to(fit.model.creep, clear),
            effects=(SecondOrderAmplifier(late_s, FLAT), *_uncoupled(clear), *others)), None)


def _with_modes_in_parallel(model: StageModel) -> StageModel:
    """Return a model whose modes with antiresonances are in parallel; else the model itself."""
    dynamics = model.dynamics
    zeros = len(dynamics.antiresonance_frequencies_rad_per_s)
    if not 0 < zeros < len(dynamics.mode_frequencies_rad_per_s):
        return model
    try:
        modes = modes_in_parallel(dynamics)
    except ValueError:  # The parts of nearly equal modes are unbounded.
        return model
    return replace(model, effects=(*modes, *model.effects),
                   dynamics=ElectricVibrationDynamics(dynamics.time_constant_s))


def between_rows(problem: WholeModel, given: StageModel,
                 delay_s: float | None) -> Iterator[Structure]:
    """Yield models with a band-limited voltage, with all modes and with only the loudest one.

    A held voltage is half a sample later, and weaker at high frequencies; a fit describes both by
    lags and further modes. Slow voltages do not distinguish the two, so these models are only
    tried when the others are clearly wrong. They do not apply to rows of means.
    """
    if not problem.is_sampled or given.dynamics.is_static and not given.effects_at("modes"):
        return
    later_s = (delay_s or 0.0) + 0.5 * problem.sample_period_s
    smooth = (BandLimitedVoltage(),)
    yield Structure("a smooth voltage", replace(given, effects=(*smooth, *given.effects)), later_s)
    mode = loudest_mode(given, problem.sample_period_s)
    yield Structure("a smooth voltage, the loudest mode", replace(
        given, dynamics=mode, effects=smooth), later_s)


def loudest_mode(model: StageModel, sample_period_s: float) -> ElectricVibrationDynamics:
    """Return a mode at the largest gain of a model within the sampled band, with that gain."""
    highest = _highest_rad_per_s(sample_period_s)
    frequency = np.geomspace(1e-3 * highest, highest, 4000)
    gain = np.abs(model.response(frequency / (2.0 * np.pi))) / np.abs(model.response([0.0]))
    loudest = int(np.argmax(gain))
    return ElectricVibrationDynamics(
        0.0, (float(frequency[loudest]),), (float(0.5 / max(gain[loudest], 1.0)),))


def _without_gaps(creep: CreepDynamics) -> CreepDynamics:
    """Return a creep of the same gain with further pairs wherever two rates are far apart."""
    while len(creep.poles_rad_per_s) > 1 and _widest_gap(creep)[1] > SETTINGS.widest_gap:
        creep = _with_pair_between(creep)
    return creep


def _widest_gap(creep: CreepDynamics) -> tuple[int, float]:
    """Return the index of the rate farthest from the next one, and their ratio."""
    poles = np.array(creep.poles_rad_per_s)
    ratios = poles[1:] / poles[:-1]
    gap = int(np.argmax(ratios))
    return gap, float(ratios[gap])


def _with_pair_between(creep: CreepDynamics) -> CreepDynamics:
    """Return a creep of the same gain with a further pair in its widest gap."""
    poles, sizes = np.array(creep.poles_rad_per_s), _sizes(creep)
    gap, ratio = _widest_gap(creep)
    share = 0.5 * max(float(sizes[gap : gap + 2].min()), SETTINGS.first_creep)
    sizes[gap : gap + 2] -= 0.5 * share
    rate_rad_per_s = poles[gap] * min(np.sqrt(ratio), SETTINGS.faster_creep)
    return _of_sizes(np.insert(poles, gap + 1, rate_rad_per_s), np.insert(sizes, gap + 1, share))


def _without_least_pair(creep: CreepDynamics) -> tuple[CreepDynamics, float]:
    """Return a creep whose smallest pair is part of the nearest one, and the rate of that pair.

    Of two nearly equal pairs of opposite signs, the sum remains.
    """
    poles, sizes = np.array(creep.poles_rad_per_s), _sizes(creep)
    least = int(np.argmin(sizes))
    others = np.arange(poles.size) != least
    nearest = int(np.argmin(np.abs(np.log(poles[others] / poles[least]))))
    remaining = sizes[others]
    remaining[nearest] += sizes[least]
    return _of_sizes(poles[others], remaining), float(poles[least])


def _sizes(creep: CreepDynamics) -> FloatArray:
    """Return the logarithm of the gain of each pair, (n,)."""
    return np.asarray(np.log(creep.zeros_rad_per_s) - np.log(creep.poles_rad_per_s))


def _of_sizes(poles_rad_per_s: ArrayLike, sizes: ArrayLike) -> CreepDynamics:
    poles = np.asarray(poles_rad_per_s, dtype=float)
    return CreepDynamics(tuple(poles.tolist()), tuple((poles * np.exp(sizes)).tolist()))


def _creep_up_to(creep: CreepDynamics, modes: Sequence[VibrationMode]) -> CreepDynamics:
    """Return a creep without wide gaps, continued to the slowest of some modes."""
    end_rad_per_s = min((mode.frequency_rad_per_s for mode in modes), default=0.0)
    return _creep_as_far_as(_without_gaps(creep), end_rad_per_s)


def _creep_as_far_as(creep: CreepDynamics, rate_rad_per_s: float,
                     pairs: int | None = None) -> CreepDynamics:
    """Return a creep with faster pairs added below some rate, which continue its trend."""
    poles, sizes = list(creep.poles_rad_per_s), _sizes(creep).tolist()
    factor, added = SETTINGS.faster_creep, 0
    if not poles or sizes[-1] <= 0.0:  # a pair of the other sign shows no trend
        return creep
    exponent = 0.0 if len(poles) < 2 or sizes[-2] <= 0.0 else np.clip(
        np.log(sizes[-1] / sizes[-2]) / np.log(poles[-1] / poles[-2]), -1.0, 0.0)
    while factor * poles[-1] < rate_rad_per_s and added != pairs:
        added += 1
        poles.append(factor * poles[-1])
        sizes.append(float(sizes[-1] * factor**exponent))
    return _of_sizes(poles, sizes)


def _in_phase(modes: Sequence[VibrationMode]) -> tuple[VibrationMode, ...]:
    """Return coupled modes normalised as modes of one structure that make up the displacement.

    Modes that nearly cancel at rest are not changed.
    """
    coupled = [mode.participation for mode in modes if type(mode) is CoupledMode]
    whole = sum(coupled)
    if abs(whole) <= SETTINGS.least_in_phase * sum(map(abs, coupled)):
        return tuple(modes)
    return tuple(
        replace(mode, participation=mode.participation / whole, velocity_participation=0.0)
        if type(mode) is CoupledMode else mode for mode in modes)


def _uncoupled(modes: Sequence[VibrationMode]) -> tuple[VibrationMode, ...]:
    """Return ringing modes as those of one structure, without velocity participation."""
    return tuple(_uncoupled_mode(mode, mode.participation) for mode in _in_phase(modes))


def _uncoupled_mode(mode: VibrationMode, participation: float) -> VibrationMode:
    """Return a mode of a structure with a participation, near another kind of mode."""
    return VibrationMode.within_limits(mode.parameters() | {
        "participation": participation,
        "damping_ratio": min(mode.damping_ratio, SETTINGS.most_uncoupled)})


def apart(modes: Sequence[VibrationMode]) -> list[VibrationMode]:
    """Return modes with overlapping ones merged: a fit may split one to follow the loops."""
    merged = list[VibrationMode]()
    for mode in sorted(modes, key=lambda mode: mode.frequency_rad_per_s):
        last = merged[-1] if merged else None
        if last is not None and mode.frequency_rad_per_s - last.frequency_rad_per_s < (
                last.damping_ratio + mode.damping_ratio) * mode.frequency_rad_per_s:
            larger = max(last, mode, key=lambda each: abs(each.participation))
            merged[-1] = type(larger).within_limits(larger.parameters() | {
                "participation": last.participation + mode.participation})
        else:
            merged.append(mode)
    return merged


def _rings(problem: WholeModel, mode: VibrationMode) -> bool:
    fastest = _end_of_band_rad_per_s(problem)
    return (mode.damping_ratio < SETTINGS.most_damped
            and SETTINGS.slowest * fastest <= mode.frequency_rad_per_s <= fastest)


def is_at_noise(problem: WholeModel, fit: WholeFit,
                above: float = SETTINGS.above_noise) -> bool:
    """Return whether the residual of each recording is explained by noise and model accuracy.

    A residual that is more than `above` times the noise is not explained.
    """
    return bool(np.all(problem.over_noise(fit) < above))


def is_better(fit: WholeFit, other: WholeFit) -> bool:
    """Return whether a fit has more evidence, even after its loss on held-out rows.

    A model with fewer parameters may lose there as much as chance explains.
    """
    gain, chance = fit.evidence_over(other), SETTINGS.chance * (fit.numbers < other.numbers)
    return gain > 0.0 and gain + fit.held_out_over(other) > -chance


def is_pointless(problem: WholeModel, before: WholeFit, best: WholeFit) -> bool:
    """Return whether a change that makes no model simpler reduced the residuals only little.

    Beside a residual that is clearly not noise, the model then lacks something that no further
    change of its structure replaces.
    """
    is_wrong = problem.over_noise(best).max() > SETTINGS.wrong
    least = SETTINGS.worthwhile if is_wrong else SETTINGS.worthwhile_near_noise
    return (is_wrong or best.numbers >= before.numbers) and (
        best.evidence_over(before) < least * best.counts.sum())


def has_modes_in_band(problem: WholeModel, fit: WholeFit) -> bool:
    """Return whether the frequencies of all additional modes are within the sampled band."""
    return all(effect.frequency_rad_per_s <= _end_of_band_rad_per_s(problem)
               for effect in fit.model.effects if type(effect) is VibrationMode)


def _end_of_band_rad_per_s(problem: WholeModel) -> float:
    """Return the highest frequency that the recordings or a response show."""
    return max([_highest_rad_per_s(problem.sample_period_s),
                *(each.highest_mode_rad_per_s for each in problem.responses)])


def _highest_rad_per_s(sample_period_s: float) -> float:
    return 2.0 * np.pi * SETTINGS.highest / sample_period_s


def structures(problem: WholeModel, fit: WholeFit) -> Iterator[Structure]:
    """Yield the structures that differ from a fitted one by one part."""
    yield from _with_less(fit)
    for structure in _elsewhere(problem, fit):
        yield replace(structure, is_far=True)
    yield from _with_more(problem, fit)


def _with_less(fit: WholeFit) -> Iterator[Structure]:
    """Yield the model without one of its parts, or with a simpler one."""
    model, delay_s = fit.model, fit.delay_s
    if delay_s is not None:
        yield Structure("without the delay", *_later(model, None, delay_s))
    weights = fit.weights_of_effects()
    modes = {place: effect for place, effect in enumerate(model.effects)
             if isinstance(effect, VibrationMode)}
    for place in sorted(modes, key=lambda place: weights[place])[: SETTINGS.modes_less]:
        mode = modes[place]
        yield Structure(f"without the {mode.name} of {mode.frequency_rad_per_s:.4g} rad/s",
                        _without(model, place), delay_s)
    yield from _in_series(model, delay_s)
    for place, effect in enumerate(model.effects):
        if place not in modes:
            yield Structure(f"without the {effect.name}", _without(model, place), delay_s)
        if isinstance(effect, SecondOrderAmplifier):
            yield Structure("its amplifier of first order", _with(
                _without(model, place), AmplifierLag(effect.time_constant_s)), delay_s)
        if isinstance(effect, CurvedBoucWenHysteresis):
            yield Structure(
                f"{BOUC_WEN} that is equal at all voltages", _with_plain_bouc_wen(model), delay_s)
    if model.dynamics.antiresonance_frequencies_rad_per_s:
        yield _without_cancelled_mode(model, delay_s)
    elif modes:
        yield from _without_modes_in_series(model, delay_s)
    if model.dynamics.time_constant_s > 0.0:
        yield Structure("without the electric time constant", *_later(
            _electric(model, 0.0), delay_s, model.dynamics.time_constant_s))
    if len(model.creep.poles_rad_per_s) > 1:
        creep, rate_rad_per_s = _without_least_pair(model.creep)
        yield Structure(f"without the creep of {rate_rad_per_s:.4g} rad/s",
                        replace(model, creep=creep), delay_s)


def _modes_and_others(model: StageModel) -> tuple[list[VibrationMode], tuple[Effect, ...]]:
    """Return the parallel modes of a model, and its other effects."""
    return ([effect for effect in model.effects if isinstance(effect, VibrationMode)],
            tuple(effect for effect in model.effects if not isinstance(effect, VibrationMode)))


def _in_series(model: StageModel, delay_s: float | None) -> Iterator[Structure]:
    """Yield the model with its parallel modes in series, if these have fewer parameters.

    A real zero of parallel modes often cancels the electric lag, which is then shorter in series.
    """
    modes, others = _modes_and_others(model)
    is_coupled = any(type(mode) is CoupledMode for mode in modes)
    if not (is_coupled or len(modes) == 1) or model.dynamics.mode_frequencies_rad_per_s:
        return
    found = modes_in_series(modes, max(mode.frequency_rad_per_s for mode in modes))
    if found is not None:
        dynamics, lead_s = found
        lag_s = model.dynamics.time_constant_s - lead_s
        in_series = replace(model, effects=others, dynamics=replace(
            dynamics, time_constant_s=max(lag_s, 0.0)))
        yield Structure(MODES_IN_SERIES, *_later(in_series, delay_s, min(lag_s, 0.0)), is_far=True)


def _without_modes_in_series(model: StageModel, delay_s: float | None) -> Iterator[Structure]:
    """Yield the model without each of its most damped modes in series."""
    dynamics = model.dynamics
    for place in np.argsort(dynamics.damping_ratios)[::-1][: SETTINGS.modes_less].tolist():
        frequencies = dynamics.mode_frequencies_rad_per_s
        yield Structure(f"without the mode of {frequencies[place]:.4g} rad/s in series", replace(
            model, dynamics=ElectricVibrationDynamics(
                dynamics.time_constant_s, _but(frequencies, place),
                _but(dynamics.damping_ratios, place))), delay_s)


def _without_cancelled_mode(model: StageModel, delay_s: float | None) -> Structure:
    """Return the model without the mode in series that is nearest to an antiresonance, and that."""
    dynamics = model.dynamics
    frequencies, zeros = (np.array(each) for each in (
        dynamics.mode_frequencies_rad_per_s, dynamics.antiresonance_frequencies_rad_per_s))
    mode, zero = np.unravel_index(
        np.argmin(np.abs(np.log(frequencies[:, None] / zeros))), (frequencies.size, zeros.size))
    return Structure(
        f"without the mode of {frequencies[mode]:.4g} rad/s near an antiresonance",
        replace(model, dynamics=ElectricVibrationDynamics(
            dynamics.time_constant_s, _but(dynamics.mode_frequencies_rad_per_s, int(mode)),
            _but(dynamics.damping_ratios, int(mode)),
            _but(dynamics.antiresonance_frequencies_rad_per_s, int(zero)),
            _but(dynamics.antiresonance_damping_ratios, int(zero)))), delay_s)


def _elsewhere(problem: WholeModel, fit: WholeFit) -> Iterator[Structure]:
    """Yield models with a lag at another place, and with other modes in parallel or loops."""
    model, delay_s = fit.model, fit.delay_s
    behind_s = model.dynamics.time_constant_s
    ahead = [place for place, effect in enumerate(model.effects)
             if isinstance(effect, AmplifierLag)]
    if behind_s > 0.0 and not ahead:
        yield Structure(
            "its electric lag in front of the hysteresis",
            _with(_electric(model, 0.0), AmplifierLag(behind_s)), delay_s)
    if behind_s > 0.0 and delay_s is None:
        yield Structure("its electric lag as a delay", _electric(model, 0.0), behind_s)
    if delay_s is not None and delay_s > 0.0 and not ahead:
        yield Structure("its delay as an amplifier's lag",
                        _with(model, AmplifierLag(delay_s)), None)
    if any(type(effect) is BoucWenHysteresis for effect in model.effects):
        yield Structure(f"{BOUC_WEN} that differs with the voltage",
                        _with_general_bouc_wen(model), delay_s)
    if any(type(effect) is VibrationMode for effect in model.effects):
        yield Structure("its modes out of phase", replace(model, effects=tuple(
            CoupledMode(*effect.parameters().values()) if type(effect) is VibrationMode else effect
            for effect in model.effects)), delay_s)
    modes, others = _modes_and_others(model)
    merged = apart(modes)
    if len(merged) < len(modes):
        yield Structure("its overlapping modes as one",
                        replace(model, effects=(*merged, *others)), delay_s)
    # Separate steps may describe a delay by several damped modes, each of which is then needed.
    alone = with_least_damped_modes(
        model, delay_s or 0.0, _highest_rad_per_s(problem.sample_period_s))
    if alone is not None:
        yield Structure("its least damped modes alone, behind a delay", *alone)
    late_s = _lag_of_coupled_modes(modes)
    if late_s > 0.0:
        yield Structure("its modes in phase, behind a delay", replace(model, effects=tuple(
            _turned_in_phase(effect) if type(effect) is CoupledMode else effect
            for effect in model.effects)), (delay_s or 0.0) + late_s)
    for place in ahead:
        moved_s = model.effects[place].parameters()["time_constant_s"]
        for kept_s in _lags_of_overdamped(model.effects[place]):
            yield Structure(
                f"its amplifier's lag of {moved_s - kept_s:.3g} s behind the hysteresis",
                _electric(_with(_without(model, place), AmplifierLag(kept_s)),
                          behind_s + moved_s - kept_s), delay_s)
        yield Structure(
            "its amplifier's lag behind the hysteresis",
            _electric(_without(model, place), behind_s + moved_s), delay_s)
        if behind_s > 0.0:
            yield Structure("its lags exchanged", _with(_electric(
                _without(model, place), moved_s), AmplifierLag(behind_s)), delay_s)


def _lags_of_overdamped(amplifier: Effect) -> tuple[float, ...]:
    """Return the two lags in s that make up an overdamped amplifier of second order, or none."""
    if not isinstance(amplifier, SecondOrderAmplifier) or amplifier.quality_factor >= 0.5:
        return ()
    half_s = 0.5 * amplifier.time_constant_s
    apart_s = half_s * np.sqrt(1.0 - 4.0 * amplifier.quality_factor**2)
    return float(half_s - apart_s), float(half_s + apart_s)


def _lag_of_coupled_modes(modes: Sequence[VibrationMode]) -> float:
    """Return the delay in s by which the velocities of coupled ones of modes are explained best.

    A delay turns the part of each mode by an angle in proportion to its frequency.
    """
    coupled = [mode for mode in modes if type(mode) is CoupledMode]
    sizes = np.array([
        np.hypot(mode.participation, mode.velocity_participation) for mode in coupled])
    lags_s = [np.arctan(-mode.velocity_participation / (mode.participation or 1e-12))
              / mode.frequency_rad_per_s for mode in coupled]
    return float(sizes @ lags_s / sizes.sum()) if sizes.any() else 0.0


def _turned_in_phase(mode: CoupledMode) -> VibrationMode:
    """Return a mode of the same size and sign without a part that follows the velocity."""
    size = np.hypot(mode.participation, mode.velocity_participation)
    return _uncoupled_mode(mode, float(np.copysign(size, mode.participation)))


def _with_more(problem: WholeModel, fit: WholeFit) -> Iterator[Structure]:
    model, delay_s = fit.model, fit.delay_s
    kinds = {type(effect) for effect in model.effects}
    if model.dynamics.is_static and not kinds:
        # Only slow recordings were given, which show nothing fast, and creep far from the optimum.
        for structure in (*_with_creep(problem, model, delay_s),
                          *_with_creep_between(model, delay_s),
                          *_with_slower_creep(problem, model, delay_s),
                          *_with_faster_creep(problem, model, delay_s)):
            yield replace(structure, is_far=True)
        return
    if delay_s is None:
        yield Structure("with a delay", model, 0.0)
    # A part of an existing lag may belong elsewhere.
    lag_s = max(SETTINGS.first_lag * problem.sample_period_s,
                0.5 * model.dynamics.time_constant_s)
    earlier, earlier_s = _later(model, delay_s, -lag_s)
    if not any(issubclass(kind, AmplifierLag) for kind in kinds):
        yield Structure("with an amplifier's lag", _with(earlier, AmplifierLag(lag_s)), earlier_s)
    if SensorLag not in kinds:
        yield Structure("with a sensor's lag", _with(earlier, SensorLag(lag_s)), earlier_s)
    if model.dynamics.time_constant_s == 0.0:
        yield Structure("with an electric time constant", _electric(earlier, lag_s), earlier_s)
    yield from _with_creep(problem, model, delay_s)
    yield from _with_creep_between(model, delay_s)
    yield from _with_slower_creep(problem, model, delay_s)
    if problem.fastest_over_noise(fit) < SETTINGS.above_noise:
        return
    for place, effect in enumerate(model.effects):
        if type(effect) is AmplifierLag:
            yield Structure("its amplifier of second order", _with(
                _without(model, place), SecondOrderAmplifier(effect.time_constant_s)), delay_s)
    yield from _with_damped_mode_in_front(model, delay_s)
    yield from _with_faster_creep(problem, model, delay_s)
    if problem.responses:
        return  # The search for the order of the response has chosen its modes.
    for mode in _further_modes(problem, fit):
        yield Structure(f"with a mode of {mode.frequency_rad_per_s:.4g} rad/s",
                        _with(model, mode), delay_s)
        # With such modes, a further one may be out of phase or overdamped.
        if any(type(effect) is CoupledMode for effect in model.effects):
            yield Structure(f"with a coupled mode of {mode.frequency_rad_per_s:.4g} rad/s", _with(
                model, CoupledMode(*mode.parameters().values())), delay_s)


def _further_modes(problem: WholeModel, fit: WholeFit) -> Iterator[VibrationMode]:
    """Yield the mode that explains most of the fastest recording, which may be one of slow errors.

    If that is far from the noise, the best mode near the others or faster follows.
    """
    shown, _ = min(zip(problem.evidence(fit), problem.over_noise(fit), strict=False),
                   key=lambda entry: (entry[0].sample_period_s, -entry[1]))
    yield from VibrationMode.starts(shown)[:1]
    known = [effect.frequency_rad_per_s for effect in fit.model.effects
             if isinstance(effect, VibrationMode)]
    if known and problem.fastest_over_noise(fit) > SETTINGS.wrong:
        yield from VibrationMode.starts(shown, 0.5 * min(known))[:1]


def _with_creep(problem: WholeModel, model: StageModel,
                delay_s: float | None) -> Iterator[Structure]:
    """Yield a model without creep with pairs over all times that a recording shows."""
    if not model.creep.poles_rad_per_s and problem.longest_s > 0.0:
        rates_rad_per_s = (
            SETTINGS.faster_creep ** np.arange(SETTINGS.first_pairs) / problem.longest_s)
        yield Structure("with creep", replace(model, creep=_of_sizes(
            rates_rad_per_s, np.full(SETTINGS.first_pairs, SETTINGS.first_creep))), delay_s,
            is_far=True)


def _with_creep_between(model: StageModel, delay_s: float | None) -> Iterator[Structure]:
    if len(model.creep.poles_rad_per_s) > 1:
        gap, _ = _widest_gap(model.creep)
        slow, fast = model.creep.poles_rad_per_s[gap : gap + 2]
        yield Structure(f"with creep between {slow:.3g} and {fast:.3g} rad/s", replace(
            model, creep=_with_pair_between(model.creep)), delay_s, is_far=True)


def _with_slower_creep(problem: WholeModel, model: StageModel,
                       delay_s: float | None) -> Iterator[Structure]:
    poles = model.creep.poles_rad_per_s
    if poles and poles[0] * problem.longest_s > SETTINGS.slowest_creep:
        rate_rad_per_s = max(poles[0] / SETTINGS.faster_creep, 1.0 / problem.longest_s)
        size = 0.5 * float(_sizes(model.creep)[0])
        yield Structure("with slower creep", replace(model, creep=_of_sizes(
            [rate_rad_per_s, *poles], [size if size > 0.0 else SETTINGS.first_creep,
                                       *_sizes(model.creep)])), delay_s, is_far=True)


def _with_faster_creep(problem: WholeModel, model: StageModel,
                       delay_s: float | None) -> Iterator[Structure]:
    creep = _creep_as_far_as(model.creep, 1.0 / problem.sample_period_s, 1)
    if creep != model.creep:
        yield Structure("with faster creep", replace(model, creep=creep), delay_s)


def _with_damped_mode_in_front(model: StageModel, delay_s: float | None) -> Iterator[Structure]:
    """Yield the model with its most damped mode in series as an amplifier of second order."""
    dynamics = model.dynamics
    damping = max(dynamics.damping_ratios, default=0.0)
    if damping <= SETTINGS.most_uncoupled or dynamics.antiresonance_frequencies_rad_per_s:
        return
    place = dynamics.damping_ratios.index(damping)
    time_s = 2.0 * damping / dynamics.mode_frequencies_rad_per_s[place]
    # Two lags that are far apart are more damped than any amplifier: the guess is the nearest one.
    amplifier = with_fitted_values(SecondOrderAmplifier(time_s), np.log([time_s, 0.5 / damping]))
    others = tuple(effect for effect in model.effects if not isinstance(effect, AmplifierLag))
    yield Structure("its damped mode as an amplifier of second order", replace(
        model, effects=(amplifier, *others), dynamics=replace(
            dynamics, mode_frequencies_rad_per_s=_but(dynamics.mode_frequencies_rad_per_s, place),
            damping_ratios=_but(dynamics.damping_ratios, place))), delay_s, is_far=True)


def _later(model: StageModel, delay_s: float | None,
           by_s: float) -> tuple[StageModel, float | None]:
    """Return a model and its delay with one of the lags changed by some time.

    This keeps the total delay of an initial model. If no lag can be shortened by so much, the
    model is returned as it is.
    """
    for place, effect in enumerate(model.effects):
        if isinstance(effect, AmplifierLag) and effect.time_constant_s + by_s > 0.0:
            longer = replace(effect, time_constant_s=effect.time_constant_s + by_s)
            return replace(model, effects=(
                *model.effects[:place], longer, *model.effects[place + 1 :])), delay_s
    electric_s = model.dynamics.time_constant_s
    if electric_s > 0.0 and electric_s + by_s > 0.0:
        return _electric(model, electric_s + by_s), delay_s
    return model, None if delay_s is None else delay_s + by_s


def _with(model: StageModel, effect: Effect) -> StageModel:
    """Return a model with one more effect: an amplifier in front of a Bouc-Wen hysteresis."""
    place = len(model.effects)
    if isinstance(effect, AmplifierLag):
        place = next((number for number, other in enumerate(model.effects)
                      if isinstance(other, BoucWenHysteresis)), place)
    return replace(model, effects=(*model.effects[:place], effect, *model.effects[place:]))


def _without(model: StageModel, place: int) -> StageModel:
    return replace(model, effects=_but(model.effects, place))


def _but(values: tuple[Any, ...], place: int) -> tuple[Any, ...]:
    return (*values[:place], *values[place + 1 :])


def _electric(model: StageModel, time_constant_s: float) -> StageModel:
    return replace(model, dynamics=replace(model.dynamics, time_constant_s=time_constant_s))
