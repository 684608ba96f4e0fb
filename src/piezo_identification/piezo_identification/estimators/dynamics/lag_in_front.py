# SPDX-License-Identifier: BSD-3-Clause
"""Lag in front of the hysteresis, told from one behind it by the shape of a step.

The lagged voltage rises through a hysteresis that is flat after a reversal and steep at its end,
so that the displacement begins later than behind a lag of the same size. A square wave of two
levels shows this once the hysteresis is known from slow loops.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.recording_start import square_part
from piezo_identification.conditioning.waveforms import played
from piezo_identification.estimators.dynamics.fast_dynamics import FastDynamics
from piezo_identification.estimators.dynamics.fast_record import FastFit, FastRecord
from piezo_identification.estimators.dynamics.output_error import fit_output_error
from piezo_identification.estimators.dynamics.square_wave import mean_period
from piezo_identification.estimators.estimate import SIGNIFICANT, Estimate, parameter_covariance
from piezo_models.effects.amplifier_lag import AmplifierLag
from piezo_models.effects.sensor_lag import SensorLag
from piezo_models.effects.vibration_mode import VibrationMode
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.recording import Recording

SHORTEST, LONGEST = 0.05, 8.0
"""In sample periods, between which a lag is sought."""

SEARCHED = 0.01
"""Logarithm of the lag to which the search goes, before it is interpolated."""

MOST_LEFT = 0.5
"""Part of the power of the residual that the lag may leave: what removes less may as well stand in
for the error of the hysteresis, with which the step is compared."""

STEP = 1e-3
"""Step of the logarithm of the lag for the derivative of the residual."""


def lag_in_front(
    recording: Recording, creep: CreepDynamics, hysteresis: PreisachModel, behind: Estimate,
    mode_count: int | None = None,
) -> Estimate | None:
    """Fit a lag in front of a known hysteresis, and the dynamics behind it anew.

    Parameters
    ----------
    recording : Recording
        A periodic square wave, see `square_wave.estimate_dynamics`.
    creep : CreepDynamics
        All of it; the creep of `behind` is part of it.
    hysteresis : PreisachModel
        From slow loops, over the voltages of the recording.
    behind : Estimate
        Of the dynamics without such a lag.
    mode_count : int, optional
        Of the dynamics; by default their order is chosen anew.

    Returns
    -------
    Estimate or None
        Its first effect is the `AmplifierLag`. None if the recording shows none.
    """
    base = mean_period(recording, creep)
    part = square_part(played(recording))
    low_v, high_v = float(part.voltage_v.min()), float(part.voltage_v.max())
    slack_v = 1e-6 * (hysteresis.voltage_max_v - hysteresis.voltage_min_v)
    if low_v < hysteresis.voltage_min_v - slack_v or high_v > hysteresis.voltage_max_v + slack_v:
        return None
    period_s = base.input.sample_period_s
    level = base.input.samples
    voltage_v = low_v + (high_v - low_v) * (level - level.min()) / np.ptp(level)
    start = FastDynamics(
        behind.model, tuple(e for e in behind.effects if isinstance(e, VibrationMode)),
        sum(e.time_constant_s for e in behind.effects if isinstance(e, SensorLag)))
    delay = behind.delay.samples if behind.delay is not None else 0.0

    def record(lag_s: float) -> FastRecord:
        driving = replace(base.input, samples=_periodic_um(voltage_v, lag_s, period_s, hysteresis))
        return replace(base, input=driving)

    def fit(logarithm: float) -> FastFit:
        lag_s = float(np.exp(logarithm))
        behind_it = record(lag_s)
        # The lag is taken from the delay, or from the lag behind: whichever leaves less.
        return min((behind_it.fit(start.order, start.vector(), each)
                    for each in (delay, delay - lag_s / period_s)), key=lambda found: found.cost)

    without = record(0.0).fit(start.order, start.vector(), delay)
    solution = minimize_scalar(
        lambda logarithm: fit(logarithm).cost, method="bounded",
        bounds=np.log([SHORTEST * period_s, LONGEST * period_s]), options={"xatol": SEARCHED})
    found = fit(solution.x)
    deviation = _deviation(record, solution.x, found)
    if found.cost > MOST_LEFT * without.cost or deviation * SIGNIFICANT > 1.0:
        return None
    lag_s = float(np.exp(solution.x))
    estimate = fit_output_error(record(lag_s), mode_count)
    if estimate.residual_rms**2 * base.kept.size > MOST_LEFT * without.cost:
        return None
    return replace(
        estimate, effects=(AmplifierLag(lag_s), *estimate.effects),
        effect_deviations=({"time_constant_s": lag_s * deviation}, *estimate.effect_deviations))


def _periodic_um(
    voltage_v: FloatArray, lag_s: float, period_s: float, hysteresis: PreisachModel,
) -> FloatArray:
    """Output of the hysteresis over one period of a voltage that has gone on for long."""
    repeated_v = np.tile(voltage_v, 3)
    if lag_s:
        repeated_v = AmplifierLag(lag_s).apply(repeated_v, period_s)
    return hysteresis.simulate(repeated_v, hysteresis.memory())[-voltage_v.size :]


def _deviation(
    record: Callable[[float], FastRecord], logarithm: float, found: FastFit,
) -> float:
    """Return the standard deviation of the logarithm of the lag, all other parameters free."""
    unknowns = np.append(found.vector, found.delay)
    changed = [record(float(np.exp(logarithm + step))).errors(found.order, unknowns)[0]
               for step in (STEP, -STEP)]
    slope = (changed[0] - changed[1]) / (2.0 * STEP)
    covariance = parameter_covariance(
        np.column_stack([found.jacobian, slope]), found.residual)
    return float(np.sqrt(covariance[-1, -1]))
