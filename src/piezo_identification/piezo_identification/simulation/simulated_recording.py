# SPDX-License-Identifier: BSD-3-Clause
"""A recording, and cached simulations of it by a model with further effects."""

from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Self

import control
import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import ComplexArray, FloatArray
from piezo_identification.conditioning.generator_edges import EARLY_EDGE, moved_between_rows
from piezo_identification.conditioning.outlier_samples import OUTLIER, good_samples
from piezo_identification.conditioning.recording_start import rests_at_first
from piezo_identification.conditioning.sensor_noise import repeated_period
from piezo_identification.conditioning.sensor_sign import moves_against
from piezo_identification.conditioning.settling import NEGLIGIBLE, first_settled
from piezo_identification.conditioning.waveforms import (
    played,
    samples_per_mean,
    with_voltage_before,
)
from piezo_identification.simulation.sampled_response import (
    SampledSystem,
    behind_lags,
    leading_lags,
)
from piezo_models.cascade import StageModel
from piezo_models.effects import Effect
from piezo_models.effects.amplifier_lag import (
    PARTS,
    advance_with_overshoot,
    as_rows_show,
    overshooting,
    parts_of_rows,
    with_overshoot,
)
from piezo_models.effects.band_limited_voltage import BandLimitedVoltage, means_of_parts
from piezo_models.hysteresis.first_rise import CYCLED
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_recorder.reading.recording import Recording

KEPT_OUTPUTS = 6
"""Number of cached outputs of the linear part, in addition to the first, and of cached signals
between later effects. A fit varies one effect at a time and needs the last few again; several fits
may run in parallel."""

FEW_PARTS = 3
"""Parts of a row in which derivatives are simulated: a step of a fit need not be exact."""

KEPT_INPUTS = 3
"""Number of cached inputs of the linear part, and of the last of several effects on the voltage."""

KEPT = 32
"""Number of cached linear parts; a fit uses the same few for all its recordings."""

PastVoltages = tuple[float, ...]
"""Extreme voltages before a recording, in their order; empty if it begins saturated."""


class SimulatedRecording:
    """The part of a recording in which a waveform is played, and its simulation by a model.

    The recording has the sign of the model and marked outliers. Raise ValueError if it has gaps, or
    is too short to settle.

    Attributes
    ----------
    past_v : tuple of float
        Voltages before the recording; none unless given by `after`.
    highest_v : float
        Highest earlier voltage, for a first rise; the stage was cycled unless given by `after`.
    read_late_s : float
        Time after its voltage at which the displacement of a row is read; 0 unless given by
        `read_at`, and for means.
    has_free_gain : bool
        Whether the gain is a nuisance: no unless given by `with_free_gain`.
    most_parts : int
        Largest number of parts in which a row is simulated: `PARTS` unless given by
        `in_few_parts`.
    ringing : (N, k) array or None
        Ringing whose amplitude and phase are a nuisance: none unless given by `with_free_ringing`.
    part : Recording
        The samples in which the waveform is played.
    time_s, voltage_v, measured_um : (N,) array
        Their time since the first of them, voltage, and displacement.
    outlier : (N,) array of bool
        True for outliers.
    off_um : (N,) array
        Error of the outliers before they were replaced by interpolation; 0 elsewhere.
    begin : int
        First sample after the start has settled; 0 if the recording begins at rest.
    settled, good : (n,) array of int
        Samples after the start has settled, and those of them that are not outliers.
    """

    past_v: PastVoltages = ()
    highest_v: float = CYCLED
    read_late_s: float = 0.0
    has_free_gain: bool = False
    most_parts: int = PARTS
    ringing: FloatArray | None = None

    def __init__(self, model: StageModel, recording: Recording) -> None:
        self.part = part = played(recording)
        self.path = recording.path
        self.sample_period_s = part.sample_period_s
        self.model = model.as_rows_show(self.sample_period_s)
        self.samples_per_mean = samples_per_mean(part)
        self.time_s = part.time_s
        self.voltage_v = np.ascontiguousarray(part.voltage_v, dtype=float)
        self.measured_um = np.ascontiguousarray(part.displacement_um, dtype=float)
        self.outlier = ~good_samples(part)
        self.off_um = part.columns.get(OUTLIER, np.zeros(self.time_s.size))
        joined_v, self._samples_before = with_voltage_before(recording, part)
        early = part.columns.get(EARLY_EDGE)
        self._joined = _RowVoltage(joined_v, None if early is None else np.concatenate(
            [np.zeros(self._samples_before), early]))
        self._rests_at_first = rests_at_first(recording)
        self.begin = 0 if self._rests_at_first else first_settled(
            model.dynamics, self.time_s, model.effects)
        self.settled = np.arange(self.begin, self.time_s.size)
        self.good = self.settled[~self.outlier[self.settled]]
        if self.good.size <= self._initial_motion(self.good[:1]).shape[1]:
            raise ValueError(f"{self.path} has {self.time_s.size} samples: record longer")
        self._bases: dict[bytes, FloatArray] = {}
        self._forget_hysteresis()
        self._forget_linear()

    def after(self, past_v: PastVoltages, highest_v: float | None = None) -> Self:
        """Return the same recording simulated after other earlier voltages."""
        other = copy(self)
        other.past_v = past_v
        other.highest_v = self.highest_v if highest_v is None else highest_v
        earlier_v = past_v or self.past_v
        if earlier_v and any(effect.memory_after(earlier_v) is not None
                             for effect in self.model.effects_at("voltage")):
            vars(other).pop("_amplified_v", None)
        other._forget_hysteresis()
        other._forget_linear()
        return other

    def with_model(self, model: StageModel) -> Self:
        """Return the same recording simulated by another model after the same past.

        The past is estimated once, with the first model, and kept while a fit changes the model.
        """
        other, given = copy(self), self.model
        other._bases = {}
        other.model = model = model.as_rows_show(self.sample_period_s)
        is_amplified_alike = (
            model.effects_at("voltage") == given.effects_at("voltage")
            and overshooting(model.effects) == overshooting(given.effects))
        if not is_amplified_alike:
            vars(other).pop("_amplified_v", None)
        if not (is_amplified_alike and model.hysteresis is given.hysteresis
                and model.first_rise is given.first_rise
                and model.hysteretic_creep is given.hysteretic_creep):
            other._forget_hysteresis()
        other._forget_linear()
        return other

    def with_effects(self, effects: Sequence[Effect]) -> Self:
        """Return the same recording simulated by a model that has further effects.

        It has the same input of the linear part as `simulate` with these effects, which is cached.
        """
        other = self.with_model(
            replace(self.model, effects=(*self.model.effects, *effects)))
        vars(other)["input_um"] = self._input_um(self._on_voltage(effects))
        return other

    def read_at(self, read_late_s: float) -> Self:
        """Return the same recording with displacements read at another time after the voltages.

        Means are not changed.
        """
        other = copy(self)
        other.read_late_s = read_late_s if self.samples_per_mean == 1 else 0.0
        other._forget_linear()
        return other

    def in_few_parts(self) -> Self:
        """Return the same recording, simulated in fewer parts of a row: faster, but less exact."""
        other = copy(self)
        other.most_parts = FEW_PARTS
        vars(other).pop("_amplified_v", None)
        other._forget_hysteresis()
        other._forget_linear()
        return other

    def with_free_gain(self) -> Self:
        """Return the same recording, whose voltages have another gain than those of others."""
        other = copy(self)
        other.has_free_gain = True
        return other

    def with_free_ringing(self, ringing: FloatArray | None) -> Self:
        """Return the same recording, in which the sizes of some signals, (N, k), are unknown."""
        other = copy(self)
        other.ringing = ringing
        return other

    def with_nuisance_of(self, other: "SimulatedRecording") -> Self:
        """Return the same recording with the free gain and the free ringing of another."""
        found = self.with_free_ringing(other.ringing)
        return found.with_free_gain() if other.has_free_gain else found

    def simulate(self, effects: Sequence[Effect] = (), quick: Sequence[Effect] = (),
                 rows: NDArray[np.intp] | None = None) -> FloatArray:
        """Return the displacement simulated by the model with further effects, (N,) or (n,).

        `quick` holds those of the effects that act on the sampled displacement if they are linear.
        That is slightly less exact than a system in series, but much faster. `rows`, (n,), holds
        the sorted samples to return, by default all; a few samples cost less.
        """
        on_voltage = self._on_voltage(effects)
        effects = as_rows_show(effects, self.sample_period_s)
        in_series = tuple(
            effect for effect in effects
            if effect.place == "modes" or effect.place == "linear" and effect not in quick
        )
        lags, others = self._leading_lags(effects)
        quick = tuple(effect for effect in quick if effect.place == "linear")
        linear_part, in_turn = (on_voltage, in_series, lags), (*quick, *others)
        if rows is None:
            return self._behind(linear_part, in_turn)
        # Derivatives in a fit need the same summation for both simulations.
        if in_turn or not any(linear_part):
            return self._behind(linear_part, in_turn)[rows]
        return self._output(*linear_part, rows)

    def _leading_lags(
        self, effects: Sequence[Effect],
    ) -> tuple[tuple[Effect, ...], tuple[Effect, ...]]:
        """Separate what the model and further effects do behind the linear part."""
        return leading_lags([
            effect for place in ("displacement", "sensor")
            for effect in (*self.model.effects, *effects) if effect.place == place
        ], self.samples_per_mean)

    def _on_voltage(self, effects: Sequence[Effect]) -> tuple[Effect, ...]:
        """Return the effects on which the input of the linear part depends."""
        effects = as_rows_show(effects, self.sample_period_s)
        return (*(effect for effect in effects if effect.place == "voltage"),
                *overshooting(effects))

    def error_um(self, rows: NDArray[np.intp] | None = None) -> float:
        """Return the RMS error at sorted rows (by default `good`), but for initial motion."""
        difference_um = self.without_initial_motion(self.measured_um - self.simulate(), rows)
        return float(np.sqrt(np.mean(difference_um**2)))

    def without_initial_motion(self, signal_um: FloatArray,
                               rows: NDArray[np.intp] | None = None) -> FloatArray:
        """Return sorted rows (by default `good`) of a signal, (N,), but for initial motion."""
        rows = self.good if rows is None else rows
        basis, chosen_um = self._basis(rows), signal_um[rows]
        return np.asarray(chosen_um - basis @ (basis.T @ chosen_um))

    def fitted_um(self, rows: NDArray[np.intp] | None = None) -> FloatArray:
        """Return the settled displacement, (n,), with the initial motion fitted at sorted rows.

        By default, these are the `good` ones.
        """
        rows = self.good if rows is None else rows
        simulated_um = self.simulate()
        sizes = np.linalg.lstsq(self._initial_motion(rows), (self.measured_um - simulated_um)[rows],
                                rcond=1e-12)[0]
        return simulated_um[self.settled] + self._initial_motion(self.settled) @ sizes

    def nuisance_regressors(self, rows: NDArray[np.intp],
                            effects: Sequence[Effect] = ()) -> FloatArray:
        """Return the regressors of offset, initial creep, ringing and gain at samples, (n, k)."""
        columns = offset_and_decays(self.model, self.time_s[rows])
        if self.ringing is not None:
            columns = np.column_stack([columns, self.ringing[rows]])
        if self.has_free_gain:
            columns = np.column_stack([columns, self.simulate(effects, rows=rows)])
        return columns

    @property
    def is_reversed(self) -> bool:
        """Whether the measured displacement moves against that of the model."""
        return moves_against(self.measured_um[self.good], self.simulate()[self.good],
                             self._initial_motion(self.good))

    def _initial_motion(self, rows: NDArray[np.intp]) -> FloatArray:
        """Return the regressors of offset, initial creep and initial ringing, (n, k)."""
        time_s = self.time_s[rows]
        columns = [offset_and_decays(self.model, time_s)]
        if not self._rests_at_first:
            poles = _linear_part(self.model, ()).poles()
            poles = poles[(poles.imag > 0.0)
                          & (poles.real * self.time_s[self.begin] > np.log(NEGLIGIBLE))]
            decays = [np.exp(pole * time_s) for pole in poles]
            columns += [part for decay in decays for part in (decay.real, decay.imag)]
        return np.column_stack(columns)

    def _basis(self, rows: NDArray[np.intp]) -> FloatArray:
        """Return an orthonormal basis of the initial motion, cached after all pasts."""
        basis = self._bases.get(rows.tobytes())
        if basis is None:
            left, values, _ = np.linalg.svd(self._initial_motion(rows), full_matrices=False)
            basis = self._bases[rows.tobytes()] = left[:, values > 1e-12 * values[0]]
        return basis

    @property
    def earlier_v(self) -> FloatArray:
        """Voltages at the hysteresis up to the first sample of the waveform, (n,)."""
        return self._amplified_v[: self._before(self._amplified_v) + 1]

    def hysteresis_output_um(self, hysteresis: PreisachModel) -> FloatArray:
        """Return the output of another hysteresis for the same voltages, in um, (N parts,).

        A first rise is not included, so that the outputs of parts of a hysteresis add up.
        """
        output_um = self._cycled_um(hysteresis, self._amplified_v)
        return output_um[self._before(output_um) :]

    def loops(self) -> tuple[FloatArray, FloatArray]:
        """Return the voltage at the hysteresis and its output at the end of each row, (N,) each.

        The voltage includes the model's effects on it.
        """
        entering_v = self._amplified_v[self._before(self._amplified_v) :]
        parts = entering_v.size // self.time_s.size
        return entering_v[parts - 1 :: parts], self.hysteresis_um[parts - 1 :: parts]

    def respond(self, system: control.StateSpace, input_um: FloatArray, delay_s: float = 0.0,
                at: NDArray[np.intp] | None = None) -> FloatArray:
        """Return the output of a continuous system at all samples, or at the sorted ones `at`."""
        sampled = self.sampled(system, delay_s, input_um.size // self.time_s.size)
        return sampled.response(input_um) if at is None else sampled.response_at(input_um, at)[:, 0]

    def sampled(self, system: control.StateSpace, delay_s: float, parts: int) -> SampledSystem:
        """Return a continuous system sampled like the recording, for inputs in parts of rows."""
        return SampledSystem(system, self.sample_period_s, self.samples_per_mean,
                             delay_s - self.read_late_s, parts)

    def linear_response(self, turn: FloatArray) -> ComplexArray:
        """Return the response of the linear part, (n,), at frequencies in turns per row.

        It is that from an input that is held in each row to the displacement of the rows.
        """
        system, delay_s = behind_lags(_linear_part(self.model, ()), self._leading_lags(())[0])
        return self.sampled(system, delay_s, 1).response_over(turn)

    def _forget_hysteresis(self) -> None:
        """Clear the cached signals up to the input of the linear part."""
        for name in ("_hysteresis_and_rest_um", "input_um"):
            vars(self).pop(name, None)
        self._inputs: dict[tuple, FloatArray] = {}
        self._ahead_v: dict[tuple, FloatArray] = {}

    def _forget_linear(self) -> None:
        """Clear the cached outputs of the linear part."""
        for name in ("rest_um", "drive_um"):
            vars(self).pop(name, None)
        self._outputs: dict[tuple, FloatArray] = {}
        self._ahead: dict[tuple, FloatArray] = {}

    @cached_property
    def _amplified_v(self) -> FloatArray:
        """Voltage after the effects of the model, in parts of all rows."""
        return self._amplified(())

    @cached_property
    def _hysteresis_and_rest_um(self) -> tuple[FloatArray, float]:
        return self._hysteresis(self.model.hysteresis, self._amplified_v)

    @property
    def hysteresis_um(self) -> FloatArray:
        """Output of the hysteresis, in um, (N parts,); see `_in_parts` for the parts of a row."""
        return self._hysteresis_and_rest_um[0]

    @cached_property
    def input_um(self) -> FloatArray:
        """Output of the hysteresis with its creep: the input of the linear part, (N parts,)."""
        return self._with_creep(self.hysteresis_um, self._amplified_v)

    @cached_property
    def rest_um(self) -> float:
        """Displacement at which the stage rested before the recording."""
        moved_um = self.hysteresis_um[0] - self._hysteresis_and_rest_um[1]
        return float(self._output((), (), ())[0] - moved_um)

    @cached_property
    def repeated_period(self) -> int | None:
        """Period of the voltage in samples after the start has settled; None if not periodic."""
        return repeated_period(self.voltage_v[self.begin :])

    @cached_property
    def drive_um(self) -> FloatArray:
        """Input of the modes: the displacement if they followed without delay, (N,)."""
        lag = type(self.model.dynamics)(self.model.dynamics.time_constant_s)
        without_modes = replace(self.model, dynamics=lag, effects=self.model.effects_at("linear"))
        return self.respond(without_modes.linear(), self.input_um)

    def _hysteresis(self, hysteresis: PreisachModel, amplified_v: FloatArray,
                    effects: Sequence[Effect] = ()) -> tuple[FloatArray, float]:
        """Return the output during the waveform, and that at the first sample of the recording."""
        output_um = self._cycled_um(hysteresis, amplified_v, effects)
        if self.model.first_rise is not None:
            output_um += self.model.first_rise.simulate(amplified_v, self.highest_v)
        return output_um[self._before(output_um) :], output_um[0]

    def _before(self, values: FloatArray) -> int:
        """Return the number of values, including parts of rows, before the waveform."""
        return self._samples_before * (values.size // self._joined.voltage_v.size)

    def _amplified(self, effects: Sequence[Effect]) -> FloatArray:
        """Return the voltage after the model's and then further effects, in parts of all rows.

        A model with all these effects applies them in the same order. The input of the last one is
        cached.
        """
        applied = (*self.model.effects, *effects)
        on_voltage = tuple(effect for effect in applied if effect.place == "voltage")
        voltage_v, parts = _in_parts(
            self._joined, on_voltage, self.sample_period_s, self.samples_per_mean, self.most_parts)
        # Of the effects behind them, these matter to what precedes the last one.
        others = (parts, any(isinstance(effect, BandLimitedVoltage) for effect in on_voltage),
                  overshooting(applied))
        for number, effect in enumerate(on_voltage):
            ahead = on_voltage[: number + 1]
            known_v = self._ahead_v.get((ahead, others))
            if known_v is None:
                past = effect.memory_after(self.past_v) if self.past_v else None
                known_v, _ = advance_with_overshoot(
                    effect, voltage_v, self.sample_period_s / parts, past, applied)
                if len(ahead) < len(on_voltage):
                    for old in list(self._ahead_v)[: 1 - KEPT_INPUTS]:
                        self._ahead_v.pop(old, None)  # a parallel fit may have removed it
                    self._ahead_v[ahead, others] = known_v
            voltage_v = known_v
        return voltage_v

    def _cycled_um(self, hysteresis: PreisachModel, amplified_v: FloatArray,
                   effects: Sequence[Effect] = ()) -> FloatArray:
        """Return the output of the hysteresis without a first rise, for the whole recording."""
        if hysteresis.is_line:
            output_um = hysteresis.line_um(amplified_v)
        else:
            memory = hysteresis.memory()
            hysteresis.simulate(self.past_v, memory)
            within_v, count = with_overshoot(
                amplified_v, amplified_v[0], (*self.model.effects, *effects))
            output_um = hysteresis.simulate(within_v, memory)[count - 1 :: count]
        if effects or self.model.effects_at("voltage"):
            return output_um  # `_in_parts` has moved the edges of the voltage
        return self._joined.with_early_edges(output_um, is_smooth=True)

    def _with_creep(self, hysteresis_um: FloatArray, amplified_v: FloatArray) -> FloatArray:
        """Return the input of the linear part: the output of the hysteresis with its creep."""
        model = self.model
        if model.hysteretic_creep is None:
            return hysteresis_um
        past, before = model.hysteresis.memory(), self._before(amplified_v)
        model.hysteresis.simulate([*self.past_v, *amplified_v[: before + 1]], past)
        memory = model.hysteretic_creep.memory(past.extremes_v[: past.top + 1])
        period_s = self.sample_period_s * self._joined.voltage_v.size / amplified_v.size
        return hysteresis_um + model.hysteretic_creep.simulate(
            amplified_v[before:], period_s, memory)

    def _behind(self, linear_part: tuple, effects: tuple[Effect, ...]) -> FloatArray:
        """Return the displacement after effects that follow the linear part in series.

        The input of the last effect is cached.
        """
        if not effects:
            return self._output(*linear_part)
        others, last = effects[:-1], effects[-1]
        key = linear_part, others
        ahead_um = self._ahead.pop(key, None)
        if ahead_um is None:
            ahead_um = self._behind(linear_part, others)
        if others:
            # Entries are ordered by their last use.
            self._ahead[key] = ahead_um
            for old in list(self._ahead)[: -KEPT_OUTPUTS]:
                self._ahead.pop(old, None)  # a parallel fit may have removed it
        return last.apply(ahead_um, self.sample_period_s, self.rest_um)

    def _output(self, on_voltage: tuple[Effect, ...], in_series: tuple[Effect, ...],
                lags: tuple[Effect, ...], at: NDArray[np.intp] | None = None) -> FloatArray:
        """Return the output of the linear part and the lags after it, cached."""
        key = on_voltage, in_series, lags, None if at is None else at.tobytes()
        output = self._outputs.get(key)
        if output is None:
            output = self._response(on_voltage, in_series, lags, at)
            # Keep the first and the last few of the many outputs of a fit.
            for old in list(self._outputs)[1 : -KEPT_OUTPUTS]:
                self._outputs.pop(old, None)  # a parallel fit may have removed it
            self._outputs[key] = output
        return output

    def _response(self, on_voltage: tuple[Effect, ...], in_series: tuple[Effect, ...],
                  lags: tuple[Effect, ...], at: NDArray[np.intp] | None = None) -> FloatArray:
        """Return the output of the linear part and the lags after it, at all samples or some."""
        input_um = self._input_um(on_voltage)
        system, delay_s = behind_lags(_linear_part(self.model, in_series), lags)
        return self.respond(system, input_um, delay_s, at)

    def _input_um(self, on_voltage: tuple[Effect, ...]) -> FloatArray:
        """Return the input of the linear part with effects on the voltage, cached."""
        if not on_voltage:
            return self.input_um
        input_um = self._inputs.get(on_voltage)
        if input_um is None:
            amplified_v = self._amplified(on_voltage)
            hysteresis_um, _ = self._hysteresis(
                self.model.hysteresis, amplified_v, on_voltage)
            input_um = self._with_creep(hysteresis_um, amplified_v)
            # A fit changes one parameter and then returns to the previous value.
            for old in list(self._inputs)[: 1 - KEPT_INPUTS]:
                self._inputs.pop(old, None)  # a parallel fit may have removed it
            self._inputs[on_voltage] = input_um
        return input_um


def offset_and_decays(model: StageModel, time_s: FloatArray) -> FloatArray:
    """Return the regressors of offset and initial creep at some times, (n, 1 + creep pairs)."""
    rates_rad_per_s = [0.0, *model.creep.poles_rad_per_s]
    if model.hysteretic_creep is not None:
        rates_rad_per_s += [1.0 / tau for tau in set(model.hysteretic_creep.time_constants_s)]
    return np.column_stack([np.exp(-rate * time_s) for rate in rates_rad_per_s])


@lru_cache(maxsize=KEPT)
def _linear_part(model: StageModel, more: tuple[Effect, ...]) -> control.StateSpace:
    """Return the linear part of a model with further effects; it must not be changed."""
    return replace(model, effects=(*model.effects, *more)).linear()


@dataclass(frozen=True, eq=False)
class _RowVoltage:
    """Recorded voltage of the rows, (N,)."""

    voltage_v: FloatArray
    early: FloatArray | None = None
    """Column `EARLY_EDGE` of a free-running generator, (N,); None for any other source."""

    def with_early_edges(self, held: FloatArray, is_smooth: bool) -> FloatArray:
        """Return a signal in parts of the rows with the edges of a generator, (N parts,)."""
        if self.early is None:
            return held
        has_parts = held.size > self.early.size
        return moved_between_rows(held, self.early, is_smooth and has_parts)

    @cached_property
    def means_v(self) -> FloatArray:
        """Means of a band-limited voltage over the parts of its rows, (N `PARTS`,)."""
        return means_of_parts(self.voltage_v, PARTS)


def _in_parts(voltage: _RowVoltage, effects: Collection[Effect], sample_period_s: float,
              samples_per_mean: int, most_parts: int) -> tuple[FloatArray, int]:
    """Return a recorded voltage divided into the parts in which its rows are simulated.

    Effects on the voltage that act within a row require several parts. Rows in which several
    samples are averaged are not divided. The result is the voltage before the effects, (N parts,),
    held, or its mean over each part for a `BandLimitedVoltage`, and the number of parts of a row.
    """
    is_smooth = any(isinstance(effect, BandLimitedVoltage) for effect in effects)
    if is_smooth and samples_per_mean == 1:
        return voltage.means_v, PARTS
    parts = min(parts_of_rows(effects, sample_period_s, samples_per_mean), most_parts)
    if voltage.early is not None and samples_per_mean == 1:
        parts = PARTS
    held = np.repeat(voltage.voltage_v, parts)
    return (voltage.with_early_edges(held, is_smooth=False) if effects else held), parts
