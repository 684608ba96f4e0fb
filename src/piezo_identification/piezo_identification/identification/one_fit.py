# SPDX-License-Identifier: BSD-3-Clause
"""The last step of an identification: a joint fit of the whole model to all recordings."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.budget import while_time_lasts
from piezo_common.cancellation import check_cancelled
from piezo_identification.conditioning.row_alignment import LATEST_READING, may_be_straight
from piezo_identification.conditioning.segments import experiment_of
from piezo_identification.conditioning.waveforms import played
from piezo_identification.estimators.estimate import DECISIVE
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_hold import of_the_stage
from piezo_identification.estimators.frequency_response.response_model import ResponseOrder
from piezo_identification.estimators.frequency_response.response_search import ResponseSearch
from piezo_identification.estimators.hysteresis.density_estimate import DensityEstimate
from piezo_identification.fitting.structure_search import (
    BOUC_WEN,
    SETTINGS,
    begun,
    best_of,
    fitted_with_bouc_wen,
    has_amplifier,
    is_at_noise,
    is_better,
    is_promising,
    promising,
    searched,
)
from piezo_identification.fitting.whole_model import NARROW_PRIOR, WIDE_PRIOR, WholeFit, WholeModel
from piezo_identification.identification.given_data import Data
from piezo_identification.identification.linear_dynamics import FittedModel
from piezo_identification.identification.notes import Detail
from piezo_identification.simulation.generator_rows import with_generator_edges
from piezo_identification.simulation.past_search import is_long_enough
from piezo_identification.simulation.simulated_recording import PastVoltages
from piezo_models.cascade import StageModel
from piezo_models.effects.delay import Delay
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_recorder.reading.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COMPONENTS_OF = {"creep": ("creep",), "dynamics": ("dynamics", "effects"),
                 "hysteresis": ("creep", "dynamics", "effects")}
"""Parts of the model that errors of a component affect, as named in the model file. Every recording
passes through the hysteresis."""

BEGUN, RENEWED = 0.3, 0.2
"""Fractions of the time for the starts, and for new loops from each, used to report progress."""

ALIKE = 1
"""Number of further starts with which the loops are estimated again besides one with another
amplifier."""

TURNS = 4
"""Largest number of times that the loops are estimated again with each start, and with each prior
width after the search; a further time only if the last one added evidence."""

SLOWER = 1.5
"""Sample period, relative to that of the fastest data, from which a voltage may be straight between
the rows. Of the fastest data, modes and lags explain that as well; see `between_rows`."""

NewLoops = Callable[
    [StageModel, Mapping[str, float], Collection[str], Mapping[str, PastVoltages], bool],
    DensityEstimate]
"""See `fitted_together`."""

Tried = Sequence[tuple[str, WholeFit]]
"""What was changed, and the fit, in the order in which they were tried."""


@dataclass(frozen=True, eq=False)
class _State:
    """A model, its best fit, and the fitting problem with its hysteresis."""

    fitted: FittedModel
    best: WholeFit
    problem: WholeModel

    read_late_s: Mapping[str, float]
    """Time by which each recording reads its rows after the voltage, without a negative delay."""
    straight: frozenset[str] = frozenset()
    """Recordings whose voltage is straight between their rows, not held."""
    gain: float = 0.0
    """Evidence that the last estimate of the loops added."""


@dataclass(frozen=True, eq=False)
class _Search:
    """The search for the best model from several starts, and all fits made in it."""

    problem: WholeModel
    names: Sequence[str]
    """Names of the recordings of the problem."""

    given: FittedModel
    read_late_s: Mapping[str, float]
    new_loops: NewLoops | None
    may_be_straight: Collection[str]
    """Recordings whose voltage may be straight between their rows."""
    is_asked_for: Callable[[StageModel], bool]
    report: Callable[[str, float], object]
    tried: list[tuple[str, WholeFit]] = field(default_factory=list)
    estimates: list[DensityEstimate] = field(default_factory=list)

    def best(self, delay_s: float | None, rival: WholeFit | None = None) -> _State:
        """Return the best model that the search finds from the promising starts.

        If all starts are far behind a rival, it is the best of them.
        """
        def with_new_loops(fit: WholeFit) -> WholeModel:
            density = self._newly_estimated(fit, self.read_late_s, ())
            return self.problem.with_hysteresis(
                replace(fit.delayed_model, hysteresis=density.model()), WIDE_PRIOR)

        found, tried = begun(
            self.problem, self.given.model, delay_s, self._part(0.0, BEGUN), self.is_asked_for,
            with_new_loops if self.new_loops is not None else None)
        self.tried.extend(tried)
        states = [_State(
            self.given if problem is self.problem else replace(
                self.given, visited=self.estimates[-1].visited),
            fit, problem, self.read_late_s) for problem, fit in found]
        if rival is not None and not is_promising(_best_of(states).best, rival):
            return _best_of(states)
        first, drifting = _best_of(states), None
        if max(self._loops_over_noise(first), default=0.0) > SETTINGS.far:
            drifting = self._drifting(first, 1.0 - BEGUN)
            if is_at_noise(drifting.problem, drifting.best, SETTINGS.wrong):
                return drifting
        raced = self._with_loops_in_turns(states)
        states = [next(state for state in raced if state.best is fit)
                  for fit in promising([state.best for state in raced])]
        length = (1.0 - BEGUN) / len(states)
        first = self._read_otherwise(states[0], BEGUN)
        drifting = self._drifting(first, length) if drifting is None else drifting
        explains_loops = self._explains_loops(drifting, first)
        is_drifting = explains_loops and is_better(drifting.best, first.best)
        if is_drifting and is_at_noise(drifting.problem, drifting.best, SETTINGS.wrong):
            return drifting
        state = self._or_of_a_line(self._from_each(first, states[1:], length), delay_s)
        if not is_drifting and explains_loops and drifting.best.evidence_over(
                first.best) > -SETTINGS.promise_before_pasts:
            drifting = self._with_bouc_wen(state, 1.0)
            if drifting is not state and is_promising(drifting.best, state.best):
                drifting = self._searched(drifting, 1.0, 0.0)
        return _better(drifting, state) if self._explains_loops(drifting, state) else state

    def _drifting(self, state: _State, length: float) -> _State:
        """Return a state with a Bouc-Wen hysteresis, and search from it if it is better."""
        drifting = self._with_bouc_wen(state, BEGUN)
        # A search behind loops of the wrong kind would describe them by dynamics.
        if self._explains_loops(drifting, state) and is_better(drifting.best, state.best):
            return self._searched(drifting, BEGUN, length)
        return drifting

    def _loops_over_noise(self, state: _State) -> FloatArray:
        """Return the residuals of recorded loops over their noise, (r,)."""
        loops = [experiment_of(name) == "hysteresis" for name in self.names]
        return state.problem.over_noise(state.best)[: len(loops)][loops]

    def _explains_loops(self, drifting: _State, state: _State) -> bool:
        """Return whether a hysteresis of another kind explains recorded loops as well, or nearly.

        It may gain more elsewhere than it loses on the loops that it should describe.
        """
        left, before = map(self._loops_over_noise, (drifting, state))
        return bool(np.all(left <= np.maximum(before, SETTINGS.wrong)))

    def _with_loops_in_turns(self, states: Sequence[_State]) -> list[_State]:
        """Estimate the loops again with each start until one is ahead; return all of these starts.

        The loops were estimated with other creep and dynamics than those of most starts, so that
        their evidence does not show yet which of them is the best one. Its rivals are the best one
        with another amplifier, and others unless it then leaves hardly more than the noise. Modes
        of the separate steps may stand for errors of the loops, so that their start is no rival,
        and has one even then.
        """
        if self.new_loops is None:
            return list(states)
        first, *others = sorted(
            states, key=lambda state: -state.best.evidence_over(states[0].best))
        others = [state for state in others if state.problem is not self.problem]
        near = [state for state in others
                if state.best.evidence_over(first.best) > -SETTINGS.promise_before_loops]
        is_given = first.problem is self.problem
        first = self._with_loops_again(first)
        alike, unlike = (
            [state for state in near
             if (has_amplifier(state.best) == has_amplifier(first.best)) == is_alike]
            for is_alike in (True, False))
        is_enough = is_at_noise(first.problem, first.best, SETTINGS.wrong)
        rivals = [*unlike[:1], *alike[: int(is_given) if is_enough else ALIKE]]
        racing = [first, *map(self._with_loops_again, rivals)]
        resting = [state for state in others if state not in rivals]
        for _ in range(TURNS - 1):
            best, further = _best_of([*racing, *resting]), list[_State]()
            for state in racing:
                # Each estimate adds less than the one before.
                if state.gain > max(DECISIVE, best.best.evidence_over(state.best)):
                    further.append(self._with_loops_again(state))
                else:
                    resting.append(state)
            racing = further
        return [*racing, *resting]

    def _with_loops_again(self, state: _State) -> _State:
        """Return a state with its loops estimated again, and how much evidence that added."""
        again = self._with_renewed_loops(state, BEGUN)
        # Few of the starts are continued.
        again.problem.forget_pieces()
        again.best.errors.forget_pieces()
        return replace(again, gain=again.best.evidence_over(state.best))

    def _from_each(self, first: _State, others: Sequence[_State], length: float) -> _State:
        """Search from the first start, and from others that may become better than its result.

        Those that are not searched from are compared as they are. If the search ends early, all
        others are compared on the held-out rows, too, because an
        amplifier of second order is the first start even if it is not the best one.
        """
        state = self._from(first, BEGUN, length)
        with while_time_lasts("the search from another start") as search:
            for number, start in enumerate(others, 1):
                check_cancelled()
                # It has to make up for what the search before has gained, too. The search makes
                # an amplifier simpler itself.
                is_new = (is_promising(start.best, state.best) if has_amplifier(start.best)
                          else is_better(start.best, state.best))
                if is_new and not is_at_noise(state.problem, state.best):
                    start = self._from(start, BEGUN + number * length, length)
                state = _better(start, state)
        if search.was_cut:
            for start in others:
                gain = start.best.evidence_over(state.best)
                state = start if gain + start.best.held_out_over(state.best) > 0.0 else state
        return state

    def with_held_out_rows(self, state: _State) -> _State:
        """Return a state refitted to all rows: those that were held out have chosen its structure.

        Otherwise what only they show would be left out of the model.
        """
        if state.best is self.tried[0][1]:
            return state
        self.report("everything together, with the held-out rows", 1.0)
        with while_time_lasts("the last fit, with the held-out rows"):
            check_cancelled()
            problem, best = state.problem.with_held_out_rows(state.best), state.best
            before, after = (problem.fit(best.model, best.delay_s, steps)
                             for steps in (0, SETTINGS.steps))
            self.tried.append(("the same, with the held-out rows", after))
            if after.evidence_over(before) > 0.0:
                return replace(state, best=after)
        return state

    def _or_of_a_line(self, state: _State, delay_s: float | None) -> _State:
        """Return a state, or the best one with a line if that is better and no loops were given.

        Hysteresis estimated from other recordings may be an artefact of incomplete dynamics.
        """
        if self.new_loops is not None or state.best.model.hysteresis.is_line:
            return state
        with while_time_lasts("a line in place of the hysteresis"):
            check_cancelled()
            problem = self.problem.with_line()
            line = replace(self, problem=problem, tried=[], given=self._given_with_line(problem))
            other = line.best(delay_s, state.best)
            self.tried.extend((f"a line: {change}", fit) for change, fit in line.tried)
            return _better(other, state)
        return state

    def _given_with_line(self, problem: WholeModel) -> FittedModel:
        every_cell = np.ones(problem.given.hysteresis.density_um_per_v2.shape, dtype=bool)
        return replace(self.given, model=problem.given, visited=every_cell)

    def _with_bouc_wen(self, state: _State, fraction: float) -> _State:
        """Return a state with a Bouc-Wen hysteresis in place of its own, whatever its evidence.

        A state near the noise or without recorded loops is returned as it is, and so is any when
        the time is over. Loops that are explained do not exclude it: a density may have followed
        them while creep and dynamics did not.
        """
        shows_loops = any(experiment_of(name) == "hysteresis" for name in self.read_late_s)
        if not shows_loops or is_at_noise(state.problem, state.best, SETTINGS.wrong):
            return state
        with while_time_lasts(BOUC_WEN):
            check_cancelled()
            self.report(BOUC_WEN, fraction)
            problem, best, tried = fitted_with_bouc_wen(state.problem, state.best)
            self.tried.extend(tried)
            if not problem.why_impossible(best):
                return replace(
                    state, fitted=self._given_with_line(problem), best=best, problem=problem)
        return state

    def _read_otherwise(self, state: _State, fraction: float) -> _State:
        """Return a state, or a better one in which the rows of a recording are read otherwise.

        The separate steps found when rows are read beside dynamics that may have been wrong, and
        took every voltage as held. A recording that is read otherwise must itself be explained
        better: a wrong model may only gain elsewhere by giving it up.
        """
        for index, name in enumerate(self.names):
            with while_time_lasts("rows that are read at another time"):
                for change, other in self._readings(state, index, name):
                    if state.problem.over_noise(state.best)[index] < SETTINGS.above_noise:
                        break
                    read = self._refitted(other, change, fraction)
                    if read.best.rms_um[index] < state.best.rms_um[index]:
                        state = _better(read, state)
        return state

    def _readings(self, state: _State, index: int, name: str) -> Iterator[tuple[str, _State]]:
        """Yield states that read the rows of a recording otherwise, before they are fitted."""
        at_once = {**state.read_late_s, name: 0.0}
        if state.read_late_s[name]:
            yield f"rows of the {name} read with their voltage", replace(
                state, problem=state.problem.read_with_voltage(index), read_late_s=at_once)
        if name in self.may_be_straight:
            yield f"a straight voltage between the rows of the {name}", replace(
                state, problem=state.problem.with_straight_voltage(index), read_late_s=at_once,
                straight=state.straight | {name})

    def _refitted(self, state: _State, change: str, fraction: float) -> _State:
        """Return a state whose problem has changed, with all parameters and the loops fitted.

        If a recording was explained much better step by step, the loops are also estimated behind
        those dynamics: the better a recording is explained the more it counts, so that no step of a
        fit leads back there.
        """
        check_cancelled()
        self.report(change, fraction)
        fit = state.problem.again(state.best, SETTINGS.steps)
        self.tried.append((change, fit))
        refitted = replace(state, best=fit)
        if is_promising(fit, state.best):
            refitted = self._with_renewed_loops(refitted, fraction)
        begun = self.tried[0][1]
        if np.any(fit.rms_um > SETTINGS.wrong * begun.rms_um):
            model = replace(fit.model, dynamics=begun.model.dynamics, effects=begun.model.effects)
            refitted = _better(self._with_renewed_loops(replace(
                state, best=state.problem.fit(model, begun.delay_s, 0)), fraction), refitted)
        return refitted

    def _from(self, start: _State, begin: float, length: float) -> _State:
        """Search for the structure, and estimate the loops again after that."""
        state = self._searched(
            start, begin + RENEWED * length, (1.0 - 2.0 * RENEWED) * length)
        end = begin + (1.0 - RENEWED) * length
        for width in (WIDE_PRIOR, NARROW_PRIOR):
            for _ in range(TURNS):
                before, state = state, self._with_renewed_loops(state, end, width)
                if state.best.evidence_over(before.best) < DECISIVE:
                    break
        return state

    def _searched(self, start: _State, begin: float, length: float) -> _State:
        best, changed = searched(
            start.problem, start.best, self._part(begin, length), self.is_asked_for)
        self.tried.extend(changed)
        return start if start.problem.why_impossible(best) else replace(start, best=best)

    def _with_renewed_loops(self, before: _State, fraction: float,
                            width: float = WIDE_PRIOR) -> _State:
        """Estimate the loops again with the fitted model, and refit.

        The prior width limits how far the fit changes the loops.
        """
        if self.new_loops is None or is_at_noise(before.problem, before.best):
            return before
        self.report("hysteresis, given the fit", fraction)
        with while_time_lasts("second estimate of the hysteresis, given the fit"):
            check_cancelled()
            density = self._newly_estimated(before.best, before.read_late_s, before.straight)
            model = replace(before.best.delayed_model, hysteresis=density.model())
            problem = before.problem.with_hysteresis(model, width)
            again = problem.fit(model, before.best.delay_s, SETTINGS.steps)
            self.tried.append(("hysteresis estimated again", again))
            if is_better(again, before.best):
                before.best.errors.forget_pieces()
                return replace(before, best=again, problem=problem, fitted=replace(
                    before.fitted, visited=density.visited))
            again.errors.forget_pieces()
        return before

    def _newly_estimated(self, fit: WholeFit, read_late_s: Mapping[str, float],
                         straight: Collection[str]) -> DensityEstimate:
        assert self.new_loops is not None
        are_plays = bool(self.estimates) and self.estimates[-1].plays is not None
        self.estimates.append(self.new_loops(
            fit.delayed_model, read_later(read_late_s, fit), straight,
            dict(zip(self.names, fit.pasts_v, strict=True)), are_plays))
        return self.estimates[-1]

    def _part(self, begin: float, length: float) -> Callable[[str, float], object]:
        return lambda what, fraction: self.report(what, begin + length * fraction)


@dataclass(frozen=True, eq=False)
class FittedTogether:
    """The result of the fit of the whole model."""

    fitted: FittedModel
    """The best of all models that were tried, including the initial one."""
    read_at: dict[str, float]
    """Instants at which the rows of each recording are read, in sample periods."""
    straight: frozenset[str] = frozenset()
    """Recordings whose voltage is straight between their rows."""
    fit: WholeFit | None = None
    """None if the model is that of the separate steps."""
    is_at_noise: bool = False


def _better(other: _State, state: _State) -> _State:
    return other if is_better(other.best, state.best) else state


def _best_of(states: Sequence[_State]) -> _State:
    best = best_of([state.best for state in states])
    return next(state for state in states if state.best is best)


def fitted_together(
    fitted: FittedModel, recordings: Mapping[str, Data], read_at: Mapping[str, float],
    new_loops: NewLoops | None,
    order: ResponseOrder,
    report: Callable[[str, float], object], note: Callable[[str], object],
) -> FittedTogether:
    """Fit all parameters of a model together, and choose its structure by the evidence.

    The conditioned recordings have their rows as given; all except the validation are fitted.
    `read_at` holds the instants at which their rows are read, in sample periods after the voltage.
    `new_loops` estimates the hysteresis again with a fitted model, the time in s by which each
    recording reads its rows late, the recordings whose voltage is straight between their rows, the
    voltages before them, and whether the last estimate was of plays.
    It is None if no recording of loops was given.
    """
    samples = {name: data for name, data in recordings.items()
               if not isinstance(data, FrequencyResponse)}
    responses = [data for data in recordings.values() if isinstance(data, FrequencyResponse)]
    if not any(experiment_of(name) != "validation" for name in samples):
        # The fit of the response is the fit of the whole model.
        return FittedTogether(fitted, dict(read_at))
    used = _long_ones(fitted.model, {
        name: data for name, data in samples.items() if experiment_of(name) != "validation"})
    parts = {name: played(data) for name, data in used.items()}
    # Rows read late are a negative delay, which the search may remove: a lag that belongs in front
    # of the hysteresis is often taken for them.
    late_s = 0.0 if responses else _late_s(read_at, parts)
    read_late_s = {
        name: max(read_at[name] * played(data).sample_period_s - late_s, 0.0)
        for name, data in samples.items()}
    delay_s = sum(effect.delay_s for effect in fitted.model.effects
                  if type(effect) is Delay) - late_s
    late_of_used_s = [read_late_s[name] for name in used]
    try:
        problem = WholeModel(
            fitted.model,
            with_generator_edges(fitted.model, list(used.values()), late_of_used_s),
            late_of_used_s, late_s,
            [ResponseSearch(of_the_stage(each, fitted.model), has_loss=True).measured_response()
             for each in responses],
            fitted.model.hysteresis.is_line and not any(
                experiment_of(name) == "hysteresis" for name in used))
    except ValueError as error:
        note(f"the model is that of the separate steps, as {error}")
        return FittedTogether(fitted, dict(read_at))
    search = _Search(
        problem, list(parts), fitted, read_late_s, new_loops,
        [name for name, part in parts.items() if may_be_straight(part)
         and part.sample_period_s > SLOWER * problem.sample_period_s],
        partial(_has_order, order), report)
    state = search.with_held_out_rows(search.best(delay_s or None))
    best = state.best
    read_at_samples = {name: late_s / played(samples[name]).sample_period_s
                       for name, late_s in read_later(state.read_late_s, best).items()}
    latest = max(read_at_samples, key=lambda name: read_at_samples[name])
    if read_at_samples[latest] > LATEST_READING:
        note(f"the model is that of the separate steps, as the fit of the whole model would read "
             f"rows of the {latest} {read_at_samples[latest]:.3g} sample periods after their "
             "voltage")
        return FittedTogether(fitted, dict(read_at))
    change, closest = max(search.tried, key=lambda entry: entry[1].evidence_over(best))
    why = problem.why_impossible(closest)
    if why and closest.evidence_over(best) > DECISIVE:
        note(f"{change} describes the recordings better than the model that is written, but {why}: "
             "check that their rows of voltage and displacement belong together")
    note(Detail(f"one fit of the whole model:\n{structure_table(search.tried, best)}",
                partial(structure_figure, search.tried, best)))
    return FittedTogether(with_fit(state.fitted, best), dict(read_at) | read_at_samples,
                          state.straight, best, is_at_noise(state.problem, best))


def _long_ones(model: StageModel, recordings: Mapping[str, Recording]) -> dict[str, Recording]:
    """Leave out the stretches between gaps that are short, unless an experiment has no others."""
    long = [name for name, data in recordings.items() if is_long_enough(model, data)]
    kinds = set(map(experiment_of, long))
    return {name: data for name, data in recordings.items()
            if name in long or experiment_of(name) not in kinds}


def read_later(read_late_s: Mapping[str, float], fit: WholeFit) -> dict[str, float]:
    """Return when rows are read, in s: a negative delay is added to the given times."""
    later_s = max(0.0, -(fit.delay_s or 0.0))
    return {name: late_s + later_s for name, late_s in read_late_s.items()}


def _late_s(read_at: Mapping[str, float], parts: Mapping[str, Recording]) -> float:
    """Return how late the fastest recording reads its rows, in s."""
    fastest = min(parts, key=lambda name: parts[name].sample_period_s)
    return read_at[fastest] * parts[fastest].sample_period_s


def _has_order(order: ResponseOrder, model: StageModel) -> bool:
    """Return whether a model has the requested numbers of creep pairs and modes."""
    modes = len(model.dynamics.mode_frequencies_rad_per_s) + sum(
        isinstance(effect, VibrationMode) for effect in model.effects)
    return (order.creep_pairs in (None, len(model.creep.poles_rad_per_s))
            and order.modes in (None, modes))


def with_fit(fitted: FittedModel, fit: WholeFit) -> FittedModel:
    """Return the model of a fit with its standard deviations."""
    of_parts, of_effects, of_delay_s = fit.deviations()
    model = fit.delayed_model
    known = {id(effect): each for effect, each in zip(fit.model.effects, of_effects, strict=True)}
    uncertainties: dict[str, Any] = dict(of_parts)
    if model.effects:
        uncertainties["effects"] = [
            {"delay_s": of_delay_s} if isinstance(effect, Delay) else known[id(effect)]
            for effect in model.effects]
    return replace(fitted, model=model, uncertainties=uncertainties)


def reliable(uncertainties: Mapping[str, Any], adequacy: Mapping[str, Mapping[str, Any]],
             is_response: bool) -> dict[str, Any]:
    """Return the standard deviations, including the errors that repeat.

    Systematic errors of an adequate component are small, but do not average out over periods as
    noise does. The deviations of the parts that it affects are multiplied by its residual over the
    noise in the same samples. Those of parts that an inadequate component affects are omitted.
    Loops do not affect dynamics from a frequency response.
    """
    factors = dict.fromkeys(("creep", "dynamics", "effects"), 1.0)
    for name, each in adequacy.items():
        if not (is_response and experiment_of(name) == "hysteresis"):
            factor = np.inf if each["verdict"] == "inadequate" else each["ratio"]
            for part in COMPONENTS_OF.get(experiment_of(name), ()):
                factors[part] = max(factors[part], factor)
    return {part: _scaled(each, factors[part]) for part, each in uncertainties.items()
            if np.isfinite(factors[part])}


def _scaled(deviations: Any, factor: float) -> Any:
    """Return numbers in mappings and sequences multiplied by a factor."""
    if isinstance(deviations, Mapping):
        return {name: _scaled(each, factor) for name, each in deviations.items()}
    if isinstance(deviations, list | tuple):
        return type(deviations)(_scaled(each, factor) for each in deviations)
    return factor * deviations


def structure_table(tried: Tried, best: WholeFit) -> str:
    """Return a table of all fits for the user, with the best one marked."""
    first = tried[0][1]
    lines = [f"{'structure':45}{'parameters':>12}{'evidence':>12}  residual (um; that of a "
             "response in its unit)"]
    for change, fit in tried:
        residual_um = ", ".join(f"{rms_um:.3g}" for rms_um in fit.rms_um)
        lines.append(f"{change:45}{fit.numbers:12d}{fit.evidence_over(first):12.1f}  {residual_um}"
                     f"{'  <- written' if fit is best else ''}")
    return "\n".join(lines)


def structure_figure(tried: Tried, best: WholeFit) -> "Figure":
    """Draw by how much the evidence of each fit is lower than that of the best one.

    A filled mark is the best one, which is written.
    """
    from piezo_common.picture_style import BLUE, label, new_figure

    figure = new_figure(height_in=0.8 + 0.22 * len(tried))
    axes = figure.subplots()
    for place, (_, fit) in enumerate(tried):
        axes.plot(best.evidence_over(fit), place, color=BLUE, marker="o",
                  fillstyle="full" if fit is best else "none")
    axes.set_xscale("symlog", linthresh=DECISIVE)
    axes.set_yticks(range(len(tried)), [change for change, _ in tried])
    axes.invert_yaxis()
    label(axes, "log-evidence below the best (1)")
    return figure
