# SPDX-License-Identifier: BSD-3-Clause
"""The residual of a model on the recording from which one of its components was estimated."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.conditioning.generator_edges import EARLY_EDGE, generator_edges
from piezo_identification.conditioning.outlier_samples import OUTLIER
from piezo_identification.conditioning.row_alignment import rows_read_at_start
from piezo_identification.conditioning.sensor_noise import repeated_period
from piezo_identification.conditioning.settling import (
    first_settled,
    rings_unresolved,
    slow_delay_s,
    slow_dynamics,
)
from piezo_identification.conditioning.waveforms import (
    SquareWave,
    played,
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
from piezo_identification.simulation.simulated_recording import (
    SimulatedRecording,
    offset_and_decays,
)
from piezo_models.cascade import StageModel
from piezo_recorder.reading.recording import Recording

WITH_FREE_GAIN = ("creep", "dynamics")
"""Components whose gain is fitted, as it belongs to the hysteresis."""

NO_STEPS = np.empty(0, dtype=np.intp)


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
    Of a square wave, only rows that the estimate of the component uses count.

    The component is ``creep``, ``dynamics`` or ``hysteresis``, and was estimated from the data.
    `delay_s` is the delay of the rows of the recording, in addition to that of the model. Raise
    ValueError if the recording has gaps, or is too short to settle.
    """
    if isinstance(data, FrequencyResponse):
        return _of_response(model, data)
    has_free_gain = component in WITH_FREE_GAIN
    part = square_part(played(data))
    wave = two_levels(part) if has_free_gain else None
    if wave is None:
        aligned = rows_read_at_start(data, -delay_s / played(data).sample_period_s)
        run = after_saturation(model, aligned).after(starting_past_v(model, aligned))
        return _of_any_wave([run], has_free_gain)
    first = _first_used(component, model, part, wave)
    levels_v = np.array([np.min(part.voltage_v), np.max(part.voltage_v)])
    held = replace(part, voltage_v=levels_v[wave.level.astype(int)])
    used = _with_rows_used(component, model, held, wave, first, delay_s)
    # The loop between the levels is closed from the first row on.
    runs = [SimulatedRecording(model, each).after(tuple(levels_v[::-1])).read_at(-delay_s)
            for each in _with_edges_tried(component, model, used, wave, delay_s)]
    return _of_any_wave(runs, True, first, wave.steps)


def _first_used(component: str, model: StageModel, part: Recording, wave: SquareWave) -> int:
    """Return the first row of a square wave after which it repeats and its start has settled."""
    first = first_settled(model.dynamics, part.time_s, model.effects)
    if component == "dynamics":
        return max(first, first_used_row(part, wave, model.creep))
    return max(first, int(wave.steps[0])) if wave.steps.size >= FEWEST_STEPS else first


def _with_rows_used(component: str, model: StageModel, part: Recording, wave: SquareWave,
                    first: int, delay_s: float) -> Recording:
    """Return a square wave with the rows that the component excludes marked as outliers."""
    rows = np.arange(wave.level.size)
    is_used = rows >= first
    if component == "creep":
        # Exclude the fast dynamics, which this recording does not resolve.
        since = rows - np.concatenate([[0], wave.steps])[
            np.searchsorted(wave.steps, rows, side="right")]
        is_used &= since * part.sample_period_s >= left_out_s(
            slow_dynamics(model.dynamics, model.effects),
            slow_delay_s(model.dynamics, model.effects) + delay_s, longest_step_s(part, wave))
        # A free-running generator steps between two rows.
        is_used[wave.steps - 1] = False
    off_um = part.columns.get(OUTLIER, np.zeros(rows.size))
    return replace(part, columns={**part.columns, OUTLIER: np.where(is_used, off_um, np.nan)})


def _with_edges_tried(component: str, model: StageModel, part: Recording, wave: SquareWave,
                      delay_s: float) -> list[Recording]:
    """Return a square wave, and also with edges between its rows if a generator ran freely."""
    edges = generator_edges(wave)
    if edges is None:
        return [part]
    if component == "creep":  # its slow rows do not show more of the edges
        return [part, replace(part, columns={**part.columns, EARLY_EDGE: edges.early})]
    return [part, with_edges_of_generator(model, part, -delay_s, keeps_instant=False)]


def _of_any_wave(runs: Sequence[SimulatedRecording], has_free_gain: bool, first: int = 0,
                 steps: NDArray[np.intp] = NO_STEPS) -> ComponentResidual:
    """Return the smallest residual of alternative simulations of the same rows.

    It begins at row `first`, so that rows before it are in no mean of periods.
    """
    run, residual_um = min(((run, _residual_um(run, has_free_gain)) for run in runs),
                           key=lambda pair: float(np.sum(pair[1][~pair[0].outlier] ** 2)))
    begin = max(first, run.begin)
    rings = rings_unresolved(
        slow_dynamics(run.model.dynamics, run.model.effects), run.voltage_v, run.sample_period_s)
    good, voltage_v = ~run.outlier & ~rings, run.voltage_v[begin:]
    return ComponentResidual(
        str(run.path), run.time_s[begin:], voltage_v, run.measured_um[begin:],
        residual_um[begin:], good[begin:], repeated_period(voltage_v),
        steps[steps >= begin] - begin)


def _residual_um(run: SimulatedRecording, has_free_gain: bool) -> FloatArray:
    """Return the residual at all rows, (N,): 0 until the start has settled."""
    simulated_um, measured_um = run.fitted_um(), run.measured_um[run.settled]
    if has_free_gain:
        columns = np.column_stack([
            simulated_um, offset_and_decays(run.model, run.time_s[run.settled])])
        good = ~run.outlier[run.settled]
        simulated_um = columns @ np.linalg.lstsq(
            columns[good], measured_um[good], rcond=1e-12)[0]
    return np.concatenate([np.zeros(run.begin), measured_um - simulated_um])


def _of_response(model: StageModel, data: FrequencyResponse) -> ComponentResidual:
    """Return the residual of real and imaginary parts, scaled to the travel of the model."""
    measured = of_the_stage(data, model)
    modelled = model.small_signal_response(measured.frequency_hz)
    gain = best_gain(modelled, measured.gain)
    travel_um = model.hysteresis.travel_um / abs(gain)
    measured_um, left_um = (
        np.concatenate([part.real, part.imag])
        for part in (travel_um * measured.gain, travel_um * (measured.gain - gain * modelled)))
    order = np.arange(measured_um.size, dtype=float)
    return ComponentResidual(
        str(data.path), order, np.zeros(order.size), measured_um, left_um,
        np.ones(order.size, dtype=bool), None, NO_STEPS,
        np.tile(measured.frequency_hz, 2))
