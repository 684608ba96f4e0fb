# SPDX-License-Identifier: BSD-3-Clause
"""Simulate a model for the voltage of a recording after different pasts."""

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.conditioning.outlier_samples import good_samples, with_outliers_marked
from piezo_identification.conditioning.sensor_sign import moves_against, reversed_displacement
from piezo_identification.conditioning.settling import AT_REST, NEGLIGIBLE, first_settled
from piezo_identification.conditioning.waveforms import (
    played,
    samples_per_mean,
    with_voltage_before,
)
from piezo_identification.simulation.nuisance import offset_and_decays
from piezo_identification.simulation.recorded_voltage import in_parts
from piezo_identification.simulation.sampled_response import (
    behind_lags,
    leading_lags,
    respond,
)
from piezo_models.cascade import StageModel
from piezo_models.effects.amplifier_lag import with_overshoot
from piezo_models.hysteresis.first_rise import CYCLED
from piezo_recorder.reading.recording import Recording

NEAR_THE_END = 1e-3
"""Distance from an end of the voltage range at which it counts as reached, as a fraction of the
range."""

PastVoltages = tuple[float, float] | tuple[()]
"""Highest and then lowest voltage before a recording; empty if it begins saturated."""


@dataclass(frozen=True)
class PastSearchSettings:
    """Settings of the search for the voltages before a recording."""

    searched_samples: int = 200_000
    """Samples at the start of the recording that are simulated for each candidate. The past affects
    the first turning points; more samples cost time and add no information."""
    grid_points: int = 6
    """Number of highest and of lowest voltages tried in each round."""
    rounds: int = 3
    """Number of grids, each around the best candidate of the one before. Three grids of six points
    resolve a hundredth of the voltage range."""
    largest_error_ratio: float = 0.9
    """Largest ratio of the errors with and without a past for which the past is accepted. Two more
    parameters always reduce the error a little."""


SETTINGS = PastSearchSettings()


def conditioned(model: StageModel, recording: Recording) -> tuple[Recording, bool]:
    """Return the recording with the sign of the model and with its outliers marked.

    Returns
    -------
    recording : Recording
    is_reversed : bool
        Whether the sign of its displacement was changed.

    Raises
    ------
    ValueError
        If the recording has gaps, or is too short to settle.
    """
    recording = with_outliers_marked(recording)
    is_reversed = ModelRun(model, recording).is_reversed
    return (reversed_displacement(recording) if is_reversed else recording), is_reversed


def starting_past_v(model: StageModel, recording: Recording) -> PastVoltages:
    """Estimate the voltages before a recording, as far as the recording depends on them.

    Unless the hysteresis is saturated at the start, a recording depends on its past. The highest
    and then the lowest earlier voltage are fitted, which represent the first turning points of any
    past. They are used if the error is clearly smaller than with a past from negative saturation.

    Returns
    -------
    (float, float) or ()
        The highest and the lowest voltage; empty if they are not used.
    """
    early = np.cumsum(recording.playing | recording.tracking) <= SETTINGS.searched_samples
    run = ModelRun(model, recording.select(early))
    if run.starts_saturated:
        return ()
    past_v = run.fitted_past_v()
    explains_more = run.error_um(past_v) < SETTINGS.largest_error_ratio * run.error_um(())
    return past_v if explains_more else ()


class ModelRun:
    """A recording, and its simulation by a model after different pasts.

    Attributes
    ----------
    part : Recording
        The samples in which the waveform is played.
    settled : ndarray of int, shape (N,)
        Samples of the part after its start has settled.
    good : ndarray of bool, shape (N,)
        True for settled samples that are used; may be replaced.

    Raises
    ------
    ValueError
        If the recording has gaps, or is too short to settle.
    """

    def __init__(self, model: StageModel, recording: Recording) -> None:
        self.part = played(recording)
        period_s = self.part.sample_period_s
        self.model = model = model.as_rows_show(period_s)
        joined_v, lead = with_voltage_before(recording, self.part)
        self._samples = samples_per_mean(self.part)
        in_parts_v, parts = in_parts(
            joined_v, model.effects_at("voltage"), period_s, self._samples)
        amplified_v = model.amplified(in_parts_v, period_s / parts)
        lead *= parts
        # Includes the first voltage of the part, from which it is simulated.
        self._before_v, self._voltage_v = amplified_v[: lead + 1], amplified_v[lead:]
        lags, self._effects = leading_lags(
            model.effects_at("displacement") + model.effects_at("sensor"), self._samples)
        self._system, self._delay_s = behind_lags(model.linear(), lags)
        time_s = self.part.time_s
        self.settled = np.arange(
            first_settled(model.dynamics, time_s, model.effects), time_s.size)
        time_s = time_s[self.settled]
        self.good = good_samples(self.part)[self.settled]
        self._nuisance = np.column_stack([
            offset_and_decays(model, time_s),
            *(self._ringing(time_s) if np.ptp(recording.voltage_v[:AT_REST]) else ()),
        ])
        self._span_of: tuple[BoolArray, FloatArray] | None = None
        if np.count_nonzero(self.good) <= self._nuisance.shape[1]:
            raise ValueError(
                f"{recording.path} has {self.part.time_s.size} samples: record longer")

    def _ringing(self, time_s: FloatArray) -> list[FloatArray]:
        """Return regressors for modes that still ring from motion before the recording."""
        poles = self._system.poles()
        poles = poles[(poles.imag > 0.0) & (poles.real * time_s[0] > np.log(NEGLIGIBLE))]
        decays = [np.exp(pole * time_s) for pole in poles]
        return [part for decay in decays for part in (decay.real, decay.imag)]

    @property
    def measured_um(self) -> FloatArray:
        """Measured displacement of the settled samples, shape (N,)."""
        return self.part.displacement_um[self.settled]

    @property
    def is_reversed(self) -> bool:
        """Whether the measured displacement moves against that of the model."""
        simulated_um = self._response_um(())
        return moves_against(
            self.measured_um[self.good], simulated_um[self.good], self._nuisance[self.good])

    @property
    def starts_saturated(self) -> bool:
        """Whether the voltage is at an end of the model's range at or before the first sample."""
        hysteresis = self.model.hysteresis
        near_v = NEAR_THE_END * (hysteresis.voltage_max_v - hysteresis.voltage_min_v)
        return bool(np.any((self._before_v <= hysteresis.voltage_min_v + near_v)
                           | (self._before_v >= hysteresis.voltage_max_v - near_v)))

    def fitted_past_v(self) -> tuple[float, float]:
        """Find the highest and then the lowest earlier voltage with the smallest error."""
        hysteresis, first_v = self.model.hysteresis, self._before_v[0]
        bounds_v = np.array([[first_v, max(first_v, hysteresis.voltage_max_v)],
                             [min(first_v, hysteresis.voltage_min_v), first_v]])
        for _ in range(SETTINGS.rounds):
            candidates = list(product(
                *(np.linspace(low_v, high_v, SETTINGS.grid_points) for low_v, high_v in bounds_v)))
            best_v = min(candidates, key=self.error_um)
            spacing_v = np.diff(bounds_v).ravel() / (SETTINGS.grid_points - 1)
            around_v = np.array(best_v)[:, None] + np.outer(spacing_v, [-1.0, 1.0])
            bounds_v = np.clip(around_v, bounds_v[:, :1], bounds_v[:, 1:])
        highest_v, lowest_v = best_v
        return float(highest_v), float(lowest_v)

    @cached_property
    def highest_v(self) -> float:
        """Highest earlier voltage: `CYCLED`, unless a lower one reduces the error clearly.

        It matters only for a model with a first rise; its hysteresis is simulated without a past.
        """
        first_rise = self.model.first_rise
        if first_rise is None:
            return CYCLED
        candidates = np.linspace(
            first_rise.voltages_v[0], first_rise.voltages_v[-1], SETTINGS.grid_points)
        errors_um = [self.error_um((), float(highest_v)) for highest_v in candidates]
        least = int(np.argmin(errors_um))
        explains_more = errors_um[least] < SETTINGS.largest_error_ratio * self.error_um((), CYCLED)
        return float(candidates[least]) if explains_more else CYCLED

    def error_um(self, past_v: PastVoltages, highest_v: float | None = None) -> float:
        """Return the RMS error with a past, with offset and initial creep projected out."""
        difference_um = (self.measured_um - self._response_um(past_v, highest_v))[self.good]
        difference_um -= self._span @ (self._span.T @ difference_um)
        return float(np.sqrt(np.mean(difference_um**2)))

    def simulated_um(self, past_v: PastVoltages) -> FloatArray:
        """Simulate the displacement after a past, with offset and initial creep fitted.

        Parameters
        ----------
        past_v : (float, float) or ()
            Voltages from `starting_past_v`.

        Returns
        -------
        ndarray, shape (N,)
        """
        simulated_um = self._response_um(past_v)
        difference_um = self.measured_um - simulated_um
        nuisance, good = self._nuisance, self.good
        return simulated_um + nuisance @ np.linalg.lstsq(
            nuisance[good], difference_um[good], rcond=1e-12)[0]

    @property
    def _span(self) -> FloatArray:
        """Orthonormal basis of the nuisance regressors at the good samples, cached for `good`."""
        if self._span_of is None or self._span_of[0] is not self.good:
            left, values, _ = np.linalg.svd(self._nuisance[self.good], full_matrices=False)
            self._span_of = self.good, left[:, values > 1e-12 * values[0]]
        return self._span_of[1]

    def _response_um(self, past_v: PastVoltages, highest_v: float | None = None) -> FloatArray:
        """Return the displacement after a past, without offset and initial creep."""
        model, part = self.model, self.part
        memory = model.hysteresis.memory()
        before_v, _ = with_overshoot(self._before_v, self._before_v[0], model.effects)
        model.hysteresis.simulate([*past_v, *before_v], memory)
        extremes_v = memory.extremes_v[: memory.top + 1].copy()
        within_v, count = with_overshoot(self._voltage_v, self._before_v[-1], model.effects)
        hysteresis_um = model.hysteresis.simulate(within_v, memory)[count - 1 :: count]
        hysteresis_um += model.hysteresis.line_beyond_um(self._voltage_v)
        parts = self._voltage_v.size // part.time_s.size
        if model.hysteretic_creep is not None:
            hysteresis_um += model.hysteretic_creep.simulate(
                self._voltage_v, part.sample_period_s / parts,
                model.hysteretic_creep.memory(extremes_v))
        if model.first_rise is not None:
            highest_v = self.highest_v if highest_v is None else highest_v
            hysteresis_um += model.first_rise.simulate(
                self._voltage_v, max(highest_v, self._before_v.max()))
        simulated_um = respond(
            self._system, hysteresis_um, part.sample_period_s, self._samples, self._delay_s,
            parts=parts)
        for effect in self._effects:
            simulated_um = effect.apply(simulated_um, part.sample_period_s)
        return simulated_um[self.settled]
