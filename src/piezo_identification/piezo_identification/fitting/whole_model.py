# SPDX-License-Identifier: BSD-3-Clause
"""Joint fits of the whole model to all recordings of its identification, and their comparison."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_common.side_by_side import side_by_side
from piezo_identification.conditioning.row_alignment import with_straight_voltage
from piezo_identification.conditioning.settling import slow_dynamics, unresolved_ringing
from piezo_identification.fitting.bouc_wen_start import with_bouc_wen
from piezo_identification.fitting.dataset import dataset_of
from piezo_identification.fitting.evidence import independent_errors, log_evidence
from piezo_identification.fitting.free_parameters import (
    changed_model,
    changes_between,
    free_count,
    kept_pieces_um,
    physical_count,
    physical_deviations,
)
from piezo_identification.fitting.joint_errors import JointErrors, OfEffects, simulated_by
from piezo_identification.fitting.joint_fit import SETTINGS as JOINT
from piezo_identification.fitting.levenberg_marquardt import Descent, descend
from piezo_identification.fitting.measured_response import MeasuredResponse
from piezo_identification.fitting.noise_estimate import estimate_noise
from piezo_identification.fitting.recording_evidence import recording_evidence
from piezo_identification.fitting.regression import SETTINGS as FIT
from piezo_identification.fitting.regression import Regression
from piezo_identification.simulation.past_search import simulated_recording
from piezo_identification.simulation.simulated_recording import PastVoltages, SimulatedRecording
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect, Evidence, fitted_values, units_of_fitted
from piezo_models.effects.band_limited_voltage import BandLimitedVoltage
from piezo_models.effects.delay import Delay
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_recorder.reading.recording import Recording

EARLIEST = 1.0
"""Largest negative delay, in sample periods, that can be fitted to rows that were not found to be
read later: the rows are then read late."""

BEFORE_DELAY = ("voltage", "modes")
"""Places of the effects of a model that act before its delay."""

LEAST_GAIN = 1e-9
"""Smallest gain of a line, in um/V, so that it is not negative."""

CURVE_CELLS = 40
"""Number of cells of a curve, whose slopes are interpolated between a few knots."""

WIDE_PRIOR, NARROW_PRIOR = 2.0, 0.02
"""Prior widths of the changes of the hysteresis, relative to those of a joint fit with new
recordings. Loops estimated with an approximate creep may be far off; those estimated with a fitted
model only need small corrections."""


@dataclass(frozen=True, eq=False)
class WholeFit:
    """A fitted model and its residuals on all recordings and responses, R in total."""

    model: StageModel
    """Model with its effects, but without its delay."""
    delay_s: float | None
    """Delay of the displacement relative to the rows as they were said to be read; negative if they
    are read later still. None for a model without a delay."""
    residual_um: list[tuple[FloatArray, FloatArray]]
    """Residuals of each recording on its fitted and on its held-out rows."""
    accuracy_um: FloatArray
    """Accuracy of a good model of each recording, (R,)."""
    errors: JointErrors = field(repr=False)
    vector: FloatArray = field(repr=False)

    counts: FloatArray = field(repr=False)
    """Number of independent errors counted in each recording, (R,): the largest number that any fit
    of the problem has reached so far."""
    has_converged: bool = False
    gain: float = 0.0
    """Gain of the minimised function by the last step."""

    free_changes: int = 0
    """Number of changes of the hysteresis with a wide prior."""

    @classmethod
    def of(cls, errors: JointErrors, descent: Descent, counts: FloatArray, model: StageModel,
           delay_s: float | None = None, free_changes: int = 0) -> "WholeFit":
        """Return the result of a descent."""
        residual_um = errors.residual_um(descent.vector)
        errors.forget()
        return cls(model, delay_s, residual_um, errors.accuracy_um, errors, descent.vector,
                   counts, descent.has_converged, descent.gain, free_changes)

    @property
    def numbers(self) -> int:
        """Return the number of estimated parameters, including those with a wide prior."""
        rise = self.model.first_rise
        return (physical_count(self.model) + (self.delay_s is not None) + self.free_changes
                + (0 if rise is None else len(rise.remanence_um) - 1)
                + sum(fitted_values(effect)[0].size for effect in self.model.effects))

    @property
    def delayed_model(self) -> StageModel:
        """Return the model with its delay as one of its effects."""
        effects = list(self.model.effects)
        if self.delay_s is not None and self.delay_s > 0.0:
            effects.append(Delay(self.delay_s))
        # The sort is stable: the effects after the delay keep their order.
        effects.sort(key=lambda effect: 0 if effect.place in BEFORE_DELAY else
                     1 if isinstance(effect, Delay) else 2)
        return replace(self.model, effects=tuple(effects))

    @property
    def rms_um(self) -> FloatArray:
        """Return the RMS residual of each recording and response on its fitted rows, (R,)."""
        return np.array([np.sqrt(np.mean(fitted**2)) for fitted, _ in self.residual_um])

    @property
    def density_changes(self) -> FloatArray:
        """Return the changes of the initial hysteresis, in widths."""
        return self.vector[physical_count(self.model) : self.errors.count]

    @property
    def pasts_v(self) -> list[PastVoltages]:
        """Return the voltages before each recording."""
        return [part.past_v for part in self.errors.dataset.simulated]

    def evidence_over(self, other: "WholeFit") -> float:
        """Return the log-evidence for this model minus that for another.

        All fits use the same number of independent errors for each recording, so that the order of
        three models does not depend on which two are compared.
        """
        mine, others = (
            log_evidence(fit._squares_um2(0), fit.numbers, self.counts) for fit in (self, other))
        return mine - others

    def held_out_over(self, other: "WholeFit") -> float:
        """Return the logarithm of the ratio of likelihoods on the held-out rows."""
        return (log_evidence(self._squares_um2(1), 0, self.counts)
                - log_evidence(other._squares_um2(1), 0, self.counts))

    def _squares_um2(self, rows: int) -> FloatArray:
        """Return mean square residual plus squared accuracy of each recording, (R,)."""
        return np.array(
            [np.mean(each[rows] ** 2) for each in self.residual_um]) + self.accuracy_um**2

    def deviations(self) -> tuple[dict[str, dict[str, Any]], list[dict[str, float]], float]:
        """Return the standard deviations of creep and dynamics, the effects, and the delay."""
        count = physical_count(self.errors.dataset.model)
        covariance = self.errors.covariance_of_all(self.vector, count)
        of_effects = np.sqrt(np.diag(covariance)[self.errors.count :])
        return (physical_deviations(self.errors.dataset.model, covariance[:count, :count]),
                *_split_deviations(self.errors.effects_at(self.vector), of_effects))

    def weights_of_effects(self) -> FloatArray:
        """Return the loss of log-evidence when each effect is removed on its own, (E,).

        It is estimated by the Wald statistic of the parameters in which the displacement is linear,
        with all others free; it is infinite if an effect has none.
        """
        covariance = self.errors.covariance_of_all(
            self.vector, physical_count(self.errors.dataset.model))
        weights, place = [], self.errors.count
        for effect in self.errors.effects_at(self.vector):
            is_linear = np.array([unit is not None for unit in units_of_fitted(effect)])
            numbers = place + np.flatnonzero(is_linear)
            place += is_linear.size
            if type(effect) is Delay:
                continue
            values, spread = self.vector[numbers], covariance[np.ix_(numbers, numbers)]
            known = bool(numbers.size) and bool(np.isfinite(spread).all())
            weights.append(0.5 * float(values @ np.linalg.lstsq(spread, values, rcond=1e-12)[0])
                           if known else np.inf if not numbers.size else 0.0)
        return np.array(weights)


class WholeModel:
    """Recordings to which whole models are fitted, starting from one identified step by step.

    The recordings have the sign of the model and marked outliers, and the measured responses have
    its sign. Each recording reads its rows `read_late_s` after the voltage; they may be read late
    by a further `later_s`, as a negative delay. With free gains, the recordings may differ in their
    gains, because a line stands for a hysteresis that none of them determines. The gain of the
    model is then that of the widest voltage. Raise ValueError if a recording is too short.
    """

    given: StageModel
    """Initial model with its hysteresis."""

    def __init__(self, model: StageModel, recordings: Sequence[Recording],
                 read_late_s: Sequence[float], later_s: float = 0.0,
                 responses: Sequence[MeasuredResponse] = (), has_free_gains: bool = False) -> None:
        self.given, self._hysteresis_width = model, WIDE_PRIOR
        simulated = _simulated(model, recordings, read_late_s)
        if has_free_gains:
            widest = max(simulated, key=lambda part: float(np.ptp(part.voltage_v)))
            simulated = [part if part is widest else part.with_free_gain() for part in simulated]
        slow = slow_dynamics(model.dynamics, model.effects)
        simulated = [part.with_free_ringing(unresolved_ringing(
            slow, part.voltage_v, part.sample_period_s)) for part in simulated]
        self.responses = tuple(responses)
        self.sample_period_s = min(
            *(part.sample_period_s for part in simulated),
            *(each.sample_period_s for each in self.responses), np.inf)
        # Rows of means cannot be read at another time, and a response shows the delay of the stage.
        self.is_sampled = not responses and all(
            part.samples_per_mean == 1 for part in simulated)
        self._earliest_s = max(
            EARLIEST * self.sample_period_s, later_s) if self.is_sampled else 0.0
        self._dataset = dataset_of(simulated, recordings, lambda _, rows: np.zeros((rows.size, 0)))
        extent = self._dataset.extent
        self._dataset = replace(self._dataset, extent=replace(extent, sample_period_s=min([
            extent.sample_period_s,
            *(np.pi / each.highest_mode_rad_per_s for each in self.responses)])))
        self.noise = estimate_noise(self._dataset, model.effects)
        good = ~self._dataset.at_rows(self.noise.outliers)
        self._fitted, self._good = self._dataset.for_estimation & good, good
        # Shared with all fits, and with copies of the problem that have another hysteresis.
        self._counts = np.zeros(len(simulated) + len(responses))
        self._are_all_fitted = False
        self.about_here()

    def with_hysteresis(self, model: StageModel, width: float,
                        past_v: PastVoltages | None = None) -> "WholeModel":
        """Return the problem with the hysteresis of a model, which also chooses the pasts.

        The model has all of its effects, and `width` is the prior width of the changes of the
        hysteresis. If the voltages before each recording, `past_v`, are not given, each has the
        past that the model finds, or keeps its own if that is closer.
        """
        problem = copy(self)
        problem.forget_pieces()
        problem.given = replace(self.given, hysteresis=model.hysteresis)
        problem._hysteresis_width = width
        problem._dataset = replace(
            self._dataset, model=replace(model, effects=()),
            simulated=tuple(side_by_side(
                lambda index: self._after_past(model, index, past_v),
                range(len(self._dataset.simulated)))))
        return problem

    def _after_past(self, model: StageModel, index: int,
                    given_v: PastVoltages | None) -> SimulatedRecording:
        """Return a recording simulated by a model without effects, after the closest past."""
        before = self._dataset.simulated[index]
        mask = [*self._dataset.masks()][index]
        rows = self._dataset.rows[index][self._good[mask]]

        def after(past_v: PastVoltages | None) -> SimulatedRecording:
            return simulated_recording(
                model, self._dataset.recordings[index], past_v, before.read_late_s)

        found = after(given_v)
        if given_v is None and found.past_v != before.past_v:
            found = min(found, after(before.past_v), key=lambda part: part.error_um(rows))
        return found.with_nuisance_of(before).with_model(replace(model, effects=()))

    def read_with_voltage(self, index: int) -> "WholeModel":
        """Return the problem with a recording whose rows are read with their voltage."""
        problem, simulated = copy(self), list(self._dataset.simulated)
        problem.about_here()
        simulated[index] = simulated[index].read_at(0.0)
        problem._dataset = replace(self._dataset, simulated=tuple(simulated))
        return problem

    def with_straight_voltage(self, index: int) -> "WholeModel":
        """Return the problem with a recording whose voltage is straight between its rows."""
        problem = copy(self)
        problem.about_here()
        simulated, recordings = list(self._dataset.simulated), list(self._dataset.recordings)
        before = simulated[index]
        recordings[index] = with_straight_voltage(recordings[index])
        changed = simulated_recording(before.model, recordings[index], before.past_v)
        simulated[index] = changed.with_nuisance_of(before)
        problem._dataset = replace(
            self._dataset, simulated=tuple(simulated), recordings=tuple(recordings))
        return problem

    def with_held_out_rows(self, fit: WholeFit) -> "WholeModel":
        """Return the problem about a fit with all rows, once no structure is chosen any more.

        The fits of this problem have no held-out rows.
        """
        problem = self.with_hysteresis(fit.delayed_model, self._hysteresis_width)
        problem._fitted, problem._counts = self._good, np.zeros_like(self._counts)
        problem._are_all_fitted = True
        return problem

    def with_line(self) -> "WholeModel":
        """Return the problem with the best-fitting line in place of its hysteresis."""
        loops = self.given.hysteresis
        unit = PreisachModel.line(loops.voltage_min_v, loops.voltage_max_v, 1.0)
        model = replace(self.given, hysteresis=unit)
        pairs = [(part.with_model(model).simulate(), part.measured_um)
                 for part in self._dataset.simulated]
        moved, measured = (np.concatenate([each - each.mean() for each in signals])
                           for signals in zip(*pairs, strict=True))
        gain_um_per_v = max(float(moved @ measured / (moved @ moved)), LEAST_GAIN)
        offset_um = np.mean([measured.mean() - gain_um_per_v * moved.mean()
                             for moved, measured in pairs])
        return self.with_hysteresis(replace(self.given, hysteresis=PreisachModel.line(
            loops.voltage_min_v, loops.voltage_max_v, gain_um_per_v, float(offset_um))),
            WIDE_PRIOR)

    def with_bouc_wen(self, model: StageModel) -> tuple["WholeModel", StageModel]:
        """Return the problem with a line, and a model with a Bouc-Wen hysteresis in front of it.

        All recordings begin at rest, or after a cycle over the whole range: loops of another shape
        are no guide to their pasts.
        """
        problem = self.with_line()
        line = problem.given.hysteresis
        start, past_v = with_bouc_wen(model, line, self._dataset.simulated, (
            (), (line.voltage_max_v, line.voltage_min_v)))
        return problem.with_hysteresis(start, WIDE_PRIOR, past_v), start

    def with_curve(self, model: StageModel) -> "WholeModel":
        """Return the problem with a curve in place of the line of a model."""
        line = model.hysteresis
        return self.with_hysteresis(replace(model, hysteresis=PreisachModel.line(
            line.voltage_min_v, line.voltage_max_v, line.gain_um_per_v()[0], line.offset_um,
            CURVE_CELLS)), WIDE_PRIOR)

    def about_here(self) -> None:
        """Make the next fit recompute how the pieces of the hysteresis change the displacement.

        Fits of similar models share this result.
        """
        self._of_pieces_um: dict[tuple[Effect, ...], dict[int, FloatArray]] = {}
        self._of_effects_um: OfEffects = {}

    def about(self, fit: WholeFit) -> None:
        """Let the first steps of the next fits use the derivatives by the effects of a fit.

        Models that differ from that of the fit in one part share the others.
        """
        self._of_effects_um = fit.errors.of_effects_um(fit.vector)

    def forget_pieces(self) -> None:
        """Drop the outputs of the pieces of the hysteresis, many times as large as the rows."""
        vars(self).pop("_pieces_um", None)
        self.about_here()

    def fit(self, model: StageModel, delay_s: float | None, steps: int,
            density_changes: FloatArray | None = None) -> WholeFit:
        """Fit all parameters of a model, its effects, and its delay.

        The delays of the initial model are ignored: the initial delay is `delay_s`, and None stands
        for no delay. The fit takes at most `steps` steps; with 0, the model remains as it is.
        `density_changes`, (n,), are changes of the initial hysteresis from an earlier fit, by
        default none.
        """
        effects = tuple(effect for effect in model.effects if type(effect) is not Delay)
        shift_s = 0.0
        if delay_s is not None:
            shift_s = self._earliest_s
            behind = next((place for place, effect in enumerate(effects)
                           if effect.place in ("displacement", "sensor")), len(effects))
            effects = (*effects[:behind], Delay(max(delay_s + shift_s, 0.0)), *effects[behind:])
        # The prior is centred on the results of the separate steps.
        about = replace(model, hysteresis=self.given.hysteresis, effects=())
        if len(model.creep.poles_rad_per_s) == len(self.given.creep.poles_rad_per_s):
            known = replace(about, creep=self.given.creep)
            about = known if np.isfinite(changes_between(known, model)).all() else about
        errors = self._errors(about, effects, shift_s)
        changes = np.zeros(errors.count)
        begun = changes_between(about, model)
        changes[: begun.size] = begun
        if density_changes is not None:
            changes[begun.size :] = density_changes
        begin = errors.vector(changes, effects)
        descent = descend(errors, begin, steps, JOINT.worthwhile)
        if self._of_effects_um and steps and np.array_equal(descent.vector, begin):
            # The shared derivatives may be too far off.
            errors.forget()
            descent = descend(errors, begin, steps, JOINT.worthwhile)
        found = errors.effects_at(descent.vector)
        fitted = changed_model(errors.dataset.model, descent.vector[: errors.count])
        delays_s = [effect.delay_s - shift_s for effect in found if type(effect) is Delay]
        fit = WholeFit.of(
            errors, descent, self._counts,
            replace(fitted, effects=tuple(each for each in found if type(each) is not Delay)),
            delays_s[0] if delays_s else None,
            errors.count - begun.size if self._hysteresis_width >= 1.0 else 0)
        np.maximum(self._counts, [independent_errors(residual) for residual, _ in fit.residual_um],
                   out=self._counts)
        return fit

    def why_impossible(self, fit: WholeFit) -> str | None:
        """Return why no stage can have all effects of a fit; see `Effect.impossible`."""
        reasons = (effect.impossible(self._dataset.extent) for effect in fit.model.effects)
        return next(filter(None, reasons), None)

    @property
    def longest_s(self) -> float:
        """Return the duration of the longest recording; 0 for responses alone."""
        return max((float(part.time_s[-1]) for part in self._dataset.simulated), default=0.0)

    def over_noise(self, fit: WholeFit) -> FloatArray:
        """Return the residual of each recording and response over its noise and accuracy, (R,)."""
        noise_um = [*self.noise.noise_um, *(each.noise for each in self.responses)]
        return fit.rms_um / np.hypot(noise_um, fit.accuracy_um)

    def fastest_over_noise(self, fit: WholeFit) -> float:
        """Return the residual of the fastest data, over its noise; responses are the fastest."""
        parts = self._dataset.simulated
        if self.responses:
            return float(self.over_noise(fit)[len(parts) :].max())
        fastest = min(range(len(parts)), key=lambda index: parts[index].sample_period_s)
        return float(self.over_noise(fit)[fastest])

    def evidence(self, fit: WholeFit) -> list[Evidence]:
        """Return what each recording shows with a fitted model, for initial guesses of effects."""
        fit.errors.linearised(fit.vector)  # of which the data set then has the derivatives
        dataset = fit.errors.dataset_at(fit.vector)
        prior = np.eye(dataset.regressors.shape[1])[dataset.nuisance_count :]
        scale_um = dataset.of_each(
            [np.hypot(np.sqrt(np.mean(residual**2)), accuracy_um)
             for (residual, _), accuracy_um in zip(
                 fit.residual_um[: len(dataset.rows)], fit.accuracy_um, strict=False)])
        regression = Regression(dataset, self.noise, scale_um, self._fitted,
                                self._good & ~self._fitted, prior)
        return recording_evidence(regression, fit.errors.effects_at(fit.vector))

    def again(self, fit: WholeFit, steps: int) -> WholeFit:
        """Continue a fit."""
        return self.fit(fit.model, fit.delay_s, steps, fit.density_changes)

    def _errors(self, bare: StageModel, effects: Sequence[Effect], shift_s: float) -> JointErrors:
        dataset = self._dataset
        if shift_s:
            dataset = replace(dataset, simulated=tuple(
                part.read_at(part.read_late_s + shift_s) for part in dataset.simulated))
        dataset = simulated_by(dataset, bare, len(dataset.simulated), frozenset())
        rows = dataset.regressors.shape[0]
        dataset = replace(dataset, regressors=np.broadcast_to(
            0.0, (rows, dataset.nuisance_count + free_count(bare))))
        smooth = tuple(each for each in effects if isinstance(each, BandLimitedVoltage))
        errors = JointErrors(
            dataset, self._fitted, self._good, len(dataset.simulated), effects, frozenset(),
            pieces_um=self._pieces_um,
            hysteresis_width=self._hysteresis_width,
            of_pieces_um=self._of_pieces_um.setdefault(smooth, {}),
            of_effects_um=self._of_effects_um,
            responses=self.responses, are_all_fitted=self._are_all_fitted)
        errors.accuracy_um = (
            FIT.adequate_tolerance / FIT.model_tolerance * errors.accuracy_um)
        return errors

    @cached_property
    def _pieces_um(self) -> list[list[FloatArray]] | None:
        return kept_pieces_um(self._dataset.simulated, self.given)


def _simulated(model: StageModel, recordings: Sequence[Recording],
               read_late_s: Sequence[float]) -> list[SimulatedRecording]:
    """Return the recordings, with the pasts that a model fits best, without its effects."""
    bare = replace(model, effects=())
    return side_by_side(
        lambda index: simulated_recording(
            model, recordings[index], read_late_s=read_late_s[index]).with_model(bare),
        range(len(recordings)))


def _split_deviations(
    effects: Sequence[Effect], of_numbers: FloatArray,
) -> tuple[list[dict[str, float]], float]:
    """Return the standard deviations of each effect except the delay, and of the delay."""
    deviations, delay_s, used = [], 0.0, 0
    for effect in effects:
        of_effect = {}
        units = units_of_fitted(effect)
        names = [each.name for each in fields(effect) if each.metadata["scale"] != "fixed"]
        for name, unit in zip(names, units, strict=True):
            # The standard deviation of a logarithm is relative to the value.
            of_effect[name] = float(
                of_numbers[used] * (1.0 if unit is not None else getattr(effect, name)))
            used += 1
        if type(effect) is Delay:
            delay_s = of_effect["delay_s"]
        else:
            deviations.append(of_effect)
    return deviations, delay_s
