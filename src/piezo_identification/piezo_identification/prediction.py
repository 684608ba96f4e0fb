# SPDX-License-Identifier: BSD-3-Clause
"""What a model says a recording should have measured, and how far it is off."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from piezo_identification.conditioning.outlier_samples import (
    good_samples,
    outliers_of_residual,
    with_outliers_marked,
)
from piezo_identification.conditioning.sensor_sign import moves_against, reversed_displacement
from piezo_identification.conditioning.settling import first_settled
from piezo_identification.conditioning.waveforms import (
    played,
    samples_per_mean,
    turning_points,
    with_voltage_before,
)
from piezo_identification.estimators.frequency_response.sampled_response import (
    behind_lags,
    leading_lags,
    respond,
)
from piezo_identification.estimators.hysteresis.everett_regression import NEAR_THE_END
from piezo_models.effects.outliers import FEWEST
from piezo_models.measures import e_y_percent

CLEARLY_LESS = 0.9
"""Part of the error below which another past has to bring it."""

SEARCHED_SAMPLES = 200_000
"""At the start of a recording, in which its past shows."""

PASTS, PAST_SEARCHES = 6, 3
"""Highest and lowest voltages of a past that are tried, in grids each around the best before."""

SLOW_BRANCH_S = 0.05
"""A way between two reversals that takes longer shows hysteresis, a shorter one dynamics."""


@dataclass(frozen=True)
class Prediction:
    """Measured and simulated displacement of the part in which the waveform plays.

    Parameters
    ----------
    time_s, voltage_v, measured_um, simulated_um : ndarray, shape (N,)
        From when the start has settled.
    past_v : (float, float) or ()
        Of `starting_past_v`.
    outlier : ndarray of bool, shape (N,), optional
        Samples that neither fits nor errors count; none by default.
    reversed : bool
        The sign of the measured displacement was changed.
    sample_index : ndarray of int, shape (N,), optional
        Of the samples in the recording.
    """

    time_s: np.ndarray
    voltage_v: np.ndarray
    measured_um: np.ndarray
    simulated_um: np.ndarray
    past_v: tuple = ()
    outlier: np.ndarray | None = None
    reversed: bool = False
    sample_index: np.ndarray | None = None

    @property
    def good(self):
        """Mask of the samples that count, shape (N,)."""
        return np.ones(self.time_s.size, dtype=bool) if self.outlier is None else ~self.outlier

    def e_y_percent(self, part=slice(None)):
        """Relative error (4.20) by the sensor, offset removed, of the whole or of a part."""
        used = np.zeros(self.time_s.size, dtype=bool)
        used[part] = True
        used &= self.good
        return e_y_percent(self.measured_um[used], self.simulated_um[used])


def predict(model, recording):
    """Simulate a model under the voltage of a recording.

    The state of the creep at the first sample, and the offset, are fitted: nothing tells what the
    stage did before. The past of the hysteresis is that of `starting_past_v`. The sign of the
    measured displacement is changed where it moves against the model. Outliers are left out: those
    that stand out of the displacement, and those that stand out of what the model leaves.

    Parameters
    ----------
    model : StageModel
    recording : Recording

    Returns
    -------
    Prediction

    Raises
    ------
    ValueError
        If the recording has gaps, or is too short to settle.
    """
    recording, is_reversed = conditioned(model, recording)
    run = _Run(model, recording)
    past_v = starting_past_v(model, recording)
    part, settled = run.part, run.settled
    simulated_um = run.simulated_um(past_v)
    standing_out = outliers_of_residual(
        part.displacement_um[settled] - simulated_um, part.displacement_um[settled],
        part.voltage_v[settled]) & run.good
    if np.count_nonzero(standing_out) >= FEWEST:
        run.good = run.good & ~standing_out
        simulated_um = run.simulated_um(past_v)
    return Prediction(
        part.time_s[settled], part.voltage_v[settled], part.displacement_um[settled],
        simulated_um, past_v, ~run.good, is_reversed, part.sample_index[settled],
    )


def conditioned(model, recording):
    """The recording with the sign of the model and its outliers marked.

    Parameters
    ----------
    model : StageModel
    recording : Recording

    Returns
    -------
    recording : Recording
    is_reversed : bool
        The sign of its displacement was changed.
    """
    recording = with_outliers_marked(recording)
    is_reversed = _Run(model, recording).is_reversed
    return (reversed_displacement(recording) if is_reversed else recording), is_reversed


def starting_past_v(model, recording):
    """Voltages that the stage had before a recording, as far as that tells.

    A recording that does not begin with the hysteresis switched off or on all over depends on what
    came before. The highest and then the lowest voltage of the past are fitted, in which the first
    turning points of any past show; they count where they explain more than a past without them,
    which comes from negative saturation.

    Parameters
    ----------
    model : StageModel
    recording : Recording

    Returns
    -------
    (float, float) or ()
        The highest and the lowest voltage.
    """
    early = np.cumsum(recording.playing | recording.tracking) <= SEARCHED_SAMPLES
    run = _Run(model, recording.select(early))
    if run.starts_saturated:
        return ()
    past_v = run.fitted_past_v()
    return past_v if run.error_um(past_v) < CLEARLY_LESS * run.error_um(()) else ()


class _Run:
    """A recording, and what a model makes of it after different pasts."""

    def __init__(self, model, recording):
        self.model, self.part = model, played(recording)
        period_s = self.part.sample_period_s
        joined_v, lead = with_voltage_before(recording, self.part)
        amplified_v = model.amplified(joined_v, period_s)
        # As far as the first voltage of the part, from which it is simulated.
        self.before_v, self.voltage_v = amplified_v[: lead + 1], amplified_v[lead:]
        self.samples = samples_per_mean(self.part)
        lags, self.effects = leading_lags(
            model.effects_at("displacement") + model.effects_at("sensor"), self.samples)
        self.system, self.delay_s = behind_lags(model.linear(), lags)
        time_s = self.part.time_s
        self.settled = np.arange(first_settled(model.dynamics, time_s), time_s.size)
        rates_rad_per_s = list(model.creep.poles_rad_per_s)
        if model.hysteretic_creep is not None:
            rates_rad_per_s += [1.0 / tau for tau in set(model.hysteretic_creep.time_constants_s)]
        time_s = time_s[self.settled]
        self.good = good_samples(self.part)[self.settled]
        self.free = np.column_stack([
            np.ones(time_s.size), *(np.exp(-rate * time_s) for rate in rates_rad_per_s)
        ])
        if np.count_nonzero(self.good) <= self.free.shape[1]:
            raise ValueError(
                f"{recording.path} has {self.part.time_s.size} samples: record longer")

    @property
    def is_reversed(self):
        """Whether the measured displacement moves against the model's."""
        measured_um = self.part.displacement_um[self.settled]
        simulated_um = self._bound_um(())
        return moves_against(
            measured_um[self.good], simulated_um[self.good], self.free[self.good])

    @property
    def starts_saturated(self):
        """Whether the first samples begin at either end of the model's voltages."""
        hysteresis = self.model.hysteresis
        near_v = NEAR_THE_END * (hysteresis.voltage_max_v - hysteresis.voltage_min_v)
        return bool(np.any((self.before_v <= hysteresis.voltage_min_v + near_v)
                           | (self.before_v >= hysteresis.voltage_max_v - near_v)))

    def fitted_past_v(self):
        """Highest and then lowest voltage before the first sample that explain most."""
        hysteresis, first_v = self.model.hysteresis, self.before_v[0]
        bounds_v = np.array([[first_v, max(first_v, hysteresis.voltage_max_v)],
                             [min(first_v, hysteresis.voltage_min_v), first_v]])
        for _ in range(PAST_SEARCHES):
            candidates = list(product(*(np.linspace(*bound, PASTS) for bound in bounds_v)))
            best_v = min(candidates, key=self.error_um)
            reach_v = np.diff(bounds_v).ravel() / (PASTS - 1)
            around_v = np.array(best_v)[:, None] + np.outer(reach_v, [-1.0, 1.0])
            bounds_v = np.clip(around_v, bounds_v[:, :1], bounds_v[:, 1:])
        return tuple(float(voltage_v) for voltage_v in best_v)

    def error_um(self, past_v):
        """RMS of what a past leaves."""
        difference_um = self.part.displacement_um[self.settled] - self.simulated_um(past_v)
        return float(np.sqrt(np.mean(difference_um[self.good] ** 2)))

    def simulated_um(self, past_v):
        """Displacement after a past, with the free parts that fit best."""
        simulated_um = self._bound_um(past_v)
        difference_um = self.part.displacement_um[self.settled] - simulated_um
        free, good = self.free, self.good
        return simulated_um + free @ np.linalg.lstsq(
            free[good], difference_um[good], rcond=1e-12)[0]

    def _bound_um(self, past_v):
        """Displacement after a past, without the free parts."""
        model, part = self.model, self.part
        past = model.hysteresis.memory()
        model.hysteresis.simulate([*past_v, *self.before_v], past)
        memory = model.memory(hysteresis=past)
        hysteresis_um = model.hysteresis.simulate(self.voltage_v, memory.hysteresis)
        if model.hysteretic_creep is not None:
            hysteresis_um += model.hysteretic_creep.simulate(
                self.voltage_v, part.sample_period_s, memory.hysteretic_creep
            )
        simulated_um = respond(
            self.system, hysteresis_um, part.sample_period_s, self.samples, self.delay_s)
        for effect in self.effects:
            simulated_um = effect.apply(simulated_um, part.sample_period_s)
        return simulated_um[self.settled]


def unseen_errors(model, recording):
    """Errors on a recording that was not fitted, by the sensor.

    Parameters
    ----------
    model : StageModel
    recording : Recording

    Returns
    -------
    dict of str to float
        `e_y_percent` of the whole, `hysteresis_e_y_percent` of the slow branches and
        `dynamics_e_y_percent` of the fast ones, as far as there are any.
    """
    return errors_of(predict(model, recording))


def errors_of(prediction):
    """The same of a prediction.

    Parameters
    ----------
    prediction : Prediction

    Returns
    -------
    dict of str to float
    """
    errors = {"e_y_percent": prediction.e_y_percent()}
    slow = slow_branches(prediction.time_s, prediction.voltage_v)
    for name, part in (("hysteresis", slow), ("dynamics", ~slow)):
        part = part & prediction.good
        if np.ptp(prediction.measured_um[part]) if part.any() else 0.0:
            errors[f"{name}_e_y_percent"] = prediction.e_y_percent(part)
    return errors


def slow_branches(time_s, voltage_v):
    """Mask of the samples between reversals that are longer than `SLOW_BRANCH_S` apart."""
    points = turning_points(voltage_v, 1e-3 * np.ptp(voltage_v))
    slow = np.zeros(voltage_v.size, dtype=bool)
    for start, end in zip(points[:-1], points[1:], strict=True):
        slow[start : end + 1] = time_s[end] - time_s[start] > SLOW_BRANCH_S
    return slow
