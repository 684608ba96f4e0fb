# SPDX-License-Identifier: BSD-3-Clause
"""The residual of a model on the recording from which one of its components was estimated."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.conditioning.generator_edges import EARLY_EDGE, free_running_level
from piezo_identification.conditioning.outlier_samples import good_samples, without_rows_before
from piezo_identification.conditioning.row_alignment import rows_read_at_start
from piezo_identification.conditioning.sensor_noise import repeated_period
from piezo_identification.conditioning.settling import (
    first_settled,
    rings_unresolved,
    slow_dynamics,
)
from piezo_identification.conditioning.waveforms import (
    SquareWave,
    played,
    samples_per_mean,
    square_part,
    two_levels,
)
from piezo_identification.estimators.creep.square_wave_creep import (
    FEWEST_STEPS,
    left_out_s,
    longest_step_s,
)
from piezo_identification.estimators.dynamics.fast_estimate import first_used_row
from piezo_identification.estimators.frequency_response.response_file import FrequencyResponse
from piezo_identification.estimators.frequency_response.response_hold import of_the_stage
from piezo_identification.fitting.measured_response import best_gain
from piezo_identification.simulation.generator_rows import with_edges_of_generator
from piezo_identification.simulation.past_search import after_saturation, starting_past_v
from piezo_identification.simulation.sampled_response import (
    behind_lags,
    leading_lags,
    respond,
)
from piezo_identification.simulation.simulated_recording import (
    RowVoltage,
    in_parts,
    offset_and_decays,
)
from piezo_models.cascade import StageModel
from piezo_recorder.reading.recording import Recording

WITH_FREE_GAIN = ("creep", "dynamics")
"""Components whose gain is fitted, as it belongs to the hysteresis."""


@dataclass(frozen=True, eq=False)
class ComponentResidual:
    """Samples of a recording, and the residual of the model."""

    path: str

    time_s: FloatArray
    voltage_v: FloatArray
    measured_um: FloatArray
    residual_um: FloatArray
    """Time, voltage, measured displacement and residual, (N,). For a frequency response, the time
    is an index, and the displacement holds real and imaginary parts, scaled to the model's
    travel."""
    good: BoolArray
    """False for outliers, and for samples after a step that the component excludes, (N,)."""
    period: int | None
    """Period of the voltage in samples; None if it is not periodic."""
    steps: NDArray[np.intp]
    """Samples at which a square wave changes its level; empty for any other input."""
    frequency_hz: FloatArray | None = None
    """Frequencies of a frequency response, (N,)."""

    @property
    def sample_period_s(self) -> float:
        """Sample period."""
        return float(self.time_s[1] - self.time_s[0])

    @property
    def error_percent(self) -> float:
        """Relative error e_y (4.20) on these samples, which were fitted."""
        measured_um = self.measured_um[self.good]
        norm_um = np.linalg.norm(measured_um - measured_um.mean())
        return float(100.0 * np.linalg.norm(self.residual_um[self.good])
                     / max(norm_um, np.finfo(float).tiny))


def component_residual(
    component: str, model: StageModel, data: Recording | FrequencyResponse, delay_s: float = 0.0,
) -> ComponentResidual:
    """Simulate a model for the data of one component, and project out all other causes of error.

    These are the offset, the initial state and, for creep and dynamics, the gain of the hysteresis.
    For a square wave, the hysteresis is an offset and a gain (4.5) and need not be simulated unless
    the model has a lag before it.

    The component is ``creep``, ``dynamics`` or ``hysteresis``, and was estimated from the data.
    `delay_s` is the delay of the rows of the recording, in addition to that of the model. Raise
    ValueError if the recording has gaps, or is too short to settle.
    """
    if isinstance(data, FrequencyResponse):
        return _of_response(model, data)
    if component in WITH_FREE_GAIN:
        part = square_part(played(data))
        wave = two_levels(part)
        if wave is not None:
            return _of_square_wave(component, model, part, wave, delay_s)
    aligned = rows_read_at_start(data, -delay_s / played(data).sample_period_s)
    return _of_any_wave(component in WITH_FREE_GAIN, model, aligned)


def _of_square_wave(
    component: str, model: StageModel, part: Recording, wave: SquareWave, delay_s: float,
) -> ComponentResidual:
    time_s = part.time_s
    samples = samples_per_mean(part)
    model = model.as_rows_show(part.sample_period_s)
    lags, _ = leading_lags(model.effects_at("displacement") + model.effects_at("sensor"), samples)
    system, behind_s = behind_lags(model.linear(), lags)
    first = first_settled(model.dynamics, time_s, model.effects)
    if component == "dynamics":
        first = max(first, first_used_row(part, wave, model.creep))
    elif wave.steps.size >= FEWEST_STEPS:
        first = max(first, int(wave.steps[0]))
    good = good_samples(part)[first:]
    if component == "creep":
        # Exclude the fast dynamics, which this recording does not resolve.
        since = np.arange(time_s.size) - np.concatenate([[0], wave.steps])[
            np.searchsorted(wave.steps, np.arange(time_s.size), side="right")]
        settled_s = left_out_s(slow_dynamics(model.dynamics, model.effects), behind_s + delay_s,
                               longest_step_s(part, wave))
        good = good & (since[first:] * part.sample_period_s >= settled_s)
        # A free-running generator steps between two rows.
        good[wave.steps[wave.steps > first] - first - 1] = False
    measured_um = part.displacement_um[first:]
    offset_and_creep = offset_and_decays(model, time_s)

    def left_um(driving: FloatArray) -> FloatArray:
        response = respond(system, driving, part.sample_period_s, samples, behind_s + delay_s,
                           parts=driving.size // time_s.size)
        columns = np.column_stack([response, offset_and_creep])[first:]
        fitted = np.linalg.lstsq(columns[good], measured_um[good], rcond=1e-12)[0]
        return np.asarray(measured_um - columns @ fitted)

    own_um = None
    if component == "dynamics":
        residual_um = left_um(_behind_hysteresis(model, part, wave.level, None))
        used = without_rows_before(part, part.sample_index[first])
        early = with_edges_of_generator(
            model, used, -delay_s, keeps_instant=False).columns.get(EARLY_EDGE)
        if early is not None:
            own_um = left_um(_behind_hysteresis(model, part, wave.level, early))
    else:
        residual_um = left_um(wave.level)
        if (own := free_running_level(wave)) is not None:
            own_um = left_um(own)
    if own_um is not None:
        if np.sum(own_um[good] ** 2) < np.sum(residual_um[good] ** 2):
            residual_um = own_um
    voltage_v = np.asarray(part.voltage_v)[first:]
    return ComponentResidual(
        str(part.path), time_s[first:], voltage_v, measured_um, residual_um,
        good, repeated_period(wave.level[first:]), wave.steps[wave.steps >= first] - first)


def _behind_hysteresis(model: StageModel, part: Recording, level: FloatArray,
                       early: FloatArray | None) -> FloatArray:
    """Return the output of the hysteresis, or the levels unless an effect acts on the voltage.

    The edges of the levels are early by a part of a row if a generator runs freely.
    """
    ahead = model.effects_at("voltage")
    low_v, high_v = float(np.min(part.voltage_v)), float(np.max(part.voltage_v))
    voltage = RowVoltage(low_v + (high_v - low_v) * (level - level.min()) / np.ptp(level), early)
    in_parts_v, parts = in_parts(voltage, ahead, part.sample_period_s, samples_per_mean(part))
    if not ahead:
        return voltage.with_early_edges(in_parts_v, is_smooth=True)
    return model.hysteresis.simulate(
        model.amplified(in_parts_v, part.sample_period_s / parts), model.hysteresis.memory())


def _of_any_wave(free_gain: bool, model: StageModel, data: Recording) -> ComponentResidual:
    run = after_saturation(model, data).after(starting_past_v(model, data))
    simulated_um = run.fitted_um()
    time_s, measured_um = run.time_s[run.settled], run.measured_um[run.settled]
    good = ~run.outlier[run.settled]
    if free_gain:
        columns = np.column_stack([simulated_um, offset_and_decays(model, time_s)])
        simulated_um = columns @ np.linalg.lstsq(
            columns[good], measured_um[good], rcond=1e-12)[0]
    rings = rings_unresolved(
        slow_dynamics(model.dynamics, model.effects), run.voltage_v, run.sample_period_s)
    voltage_v = run.voltage_v[run.settled]
    return ComponentResidual(
        str(data.path), time_s, voltage_v, measured_um, measured_um - simulated_um,
        good & ~rings[run.settled],
        repeated_period(voltage_v), np.empty(0, dtype=np.intp))


def _of_response(model: StageModel, data: FrequencyResponse) -> ComponentResidual:
    """Return the residual of real and imaginary parts, scaled to the travel of the model."""
    measured = of_the_stage(data, model)
    modelled = model.small_signal_response(measured.frequency_hz)
    gain = best_gain(model, modelled, measured.gain)
    travel_um = model.hysteresis.travel_um / abs(gain)
    measured_um, left_um = (
        np.concatenate([part.real, part.imag])
        for part in (travel_um * measured.gain, travel_um * (measured.gain - gain * modelled)))
    order = np.arange(measured_um.size, dtype=float)
    return ComponentResidual(
        str(data.path), order, np.zeros(order.size), measured_um, left_um,
        np.ones(order.size, dtype=bool), None, np.empty(0, dtype=np.intp),
        np.tile(measured.frequency_hz, 2))
