# SPDX-License-Identifier: BSD-3-Clause
"""Electric and vibration dynamics from any fast recordings, for the least output error.

The input of the dynamics is simulated with a known hysteresis or with that of the recordings
themselves; for two levels it is an offset and a gain (4.5). The measured displacement is fitted to
the response.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.creep_removal import remove_creep
from piezo_identification.conditioning.generator_edges import generator_edges
from piezo_identification.conditioning.recording_start import (
    AT_REST,
    LONGEST_LOOK,
    STILL,
    rings,
)
from piezo_identification.conditioning.segments import Recordings, listed
from piezo_identification.conditioning.sensor_noise import noise_floor_um
from piezo_identification.conditioning.settling import USUAL_SETTLING_S
from piezo_identification.conditioning.waveforms import (
    SquareWave,
    first_settled_step,
    square_part,
    square_wave,
    two_levels,
)
from piezo_identification.estimators.dynamics.fast_creep import (
    fit_with_fast_creep,
    project_out_slow_error,
)
from piezo_identification.estimators.dynamics.fast_dynamics import ModeOrder
from piezo_identification.estimators.dynamics.fast_record import FastRecord
from piezo_identification.estimators.dynamics.fast_signals import (
    FEWEST_SAMPLES,
    LATE_ROWS,
    drift_basis,
    joined_record,
    played_at_the_clock,
    through_hysteresis,
)
from piezo_identification.estimators.dynamics.generator_signals import (
    MODES_TO_DECIDE,
    with_edges_between,
)
from piezo_identification.estimators.dynamics.output_error import fit_output_error
from piezo_identification.estimators.estimate import Estimate
from piezo_identification.estimators.hysteresis.fast_loops import FastLoops
from piezo_identification.estimators.hysteresis.loops_with_dynamics import hysteresis_with_dynamics
from piezo_identification.estimators.poles.pole_responses import HeldInput
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics
from piezo_recorder.reading.recording import Recording

WARM_UP_S = 0.3
"""Smallest part at the start of a square wave that is not used, because the approach from rest
still affects it."""

AT_END = 20
"""Number of samples at the end of a visit of a level that show where it ended."""

MOST_LEFT_OUT = 0.4
"""Largest part of a recording that is omitted until its past no longer matters."""

NEAR_AN_EXTREME = 0.05
"""Distance from both ends of the range, relative to it, that the voltage must have reached for the
past to act only as an offset."""


def estimate_dynamics(
    recordings: Recordings, creep: CreepDynamics, mode_count: int | None = None,
    delay: float | None = None, among: Collection[ModeOrder] = (),
    hysteresis: PreisachModel | None = None,
) -> Estimate:
    """Estimate electric lag, vibration modes (4.3) and delay from fast recordings.

    The creep is removed by its inverse. A vector fit finds initial poles, and the physical
    parameters are then fitted for the least output error of the exactly sampled model, with offset
    and initial creep free. Of a square wave with a period of a whole number of samples, the mean
    period is fitted.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        Recordings of any fast voltage without gaps, at the full sample clock and with the same
        sample period. Each has its own offset and initial creep.
    mode_count : int, optional
        Number of modes in series without antiresonances; by default as many of both, and of
        parallel modes, as the evidence justifies.
    delay : float, optional
        Delay of the rows in sample periods; by default it is estimated.
    among : collection of ModeOrder
        See `output_error.fit_output_error`.
    hysteresis : PreisachModel, optional
        Known hysteresis, valid for the voltages of the recordings. By default it is estimated
        from the recordings together with the dynamics; for two levels, it is an offset and a
        gain.

    Returns
    -------
    Estimate
        Its model is an `ElectricVibrationDynamics`; its order counts modes. The standard
        deviations assume exact hysteresis and creep.

    Raises
    ------
    ValueError
        If a recording has gaps, is averaged, leaves the hysteresis' range, or is too short.

    Examples
    --------
    >>> import numpy as np
    >>> from piezo_models import (
    ...     CreepDynamics, ElectricVibrationDynamics, PreisachModel, StageModel)
    >>> from piezo_recorder import recording_of
    >>> line = PreisachModel.line(0.0, 10.0, 2.0)
    >>> mode = ElectricVibrationDynamics(0.0, (1000.0,), (0.02,))
    >>> stage = StageModel(line, CreepDynamics(), mode)
    >>> sample = np.arange(6000)
    >>> voltage_v = np.where(sample % 1000 < 500, 0.0, 10.0)
    >>> estimate = estimate_dynamics(recording_of({
    ...     "time_s": 1e-4 * sample, "voltage_v": voltage_v,
    ...     "displacement_um": stage.simulate(voltage_v, 1e-4)}), CreepDynamics(), mode_count=1)
    >>> print(np.round(estimate.model.mode_frequencies_rad_per_s))
    [1000.]
    """
    fit = partial(fit_output_error, mode_count=mode_count, delay=delay, among=among)
    given = listed(recordings)
    parts = [played_at_the_clock(recording) for recording in given]
    squares = [square_part(part) for part in parts]
    waves = [wave for square in squares if (wave := two_levels(square)) is not None]
    if len(waves) == len(parts) == 1 and _is_periodic(parts[0], waves[0]):
        return fit_with_fast_creep(lambda known: mean_period(parts[0], known), creep, fit)
    if len(waves) == len(parts):
        levels = [wave.level for wave in waves]
        timed = with_edges_between(
            _record(squares, levels, creep), [generator_edges(wave) for wave in waves])
        return fit_with_fast_creep(
            lambda known: replace(_record(squares, levels, known), input=timed.input,
                                  phase_room=timed.phase_room), creep, fit)
    if hysteresis is not None:
        entering_um = [through_hysteresis(recording, part, hysteresis)
                       for recording, part in zip(given, parts, strict=True)]
        return fit_with_fast_creep(
            lambda known: project_out_slow_error(replace(
                _record(parts, entering_um, known), is_driven_by_loops=True)), creep, fit)
    without_hysteresis = _record(
        parts, [np.asarray(part.voltage_v, dtype=float) for part in parts], creep)
    linear = fit_output_error(without_hysteresis, MODES_TO_DECIDE, delay)
    estimate = fit(_behind_hysteresis(parts, creep))
    if estimate.residual_rms < linear.residual_rms:
        return estimate
    return fit_output_error(without_hysteresis, mode_count, delay)


def _is_periodic(part: Recording, wave: SquareWave) -> bool:
    """Return whether a square wave has a period of a whole number of samples."""
    steps = wave.steps[wave.steps >= WARM_UP_S / part.sample_period_s]
    return steps.size >= 3 and bool(np.all(steps[2:] - steps[:-2] == steps[2] - steps[0]))


def first_used_row(part: Recording, wave: SquareWave, creep: CreepDynamics) -> int:
    """Return the first row of a square wave that is used, within the first half."""
    earliest = int(np.searchsorted(part.time_s, WARM_UP_S))
    quick_um = remove_creep(part.displacement_um, creep, part.sample_period_s)
    settled = first_settled_step(quick_um, wave.steps, earliest)
    if settled > np.searchsorted(wave.steps, earliest):
        earliest = int(wave.steps[settled])
    return min(earliest, part.time_s.size // 2)


def mean_period(recording: Recording, creep: CreepDynamics) -> FastRecord:
    """Return the mean period of a periodic square wave with the creep removed."""
    part = square_part(played_at_the_clock(recording))
    period_s = part.sample_period_s
    wave = square_wave(part)
    quick_um = remove_creep(part.displacement_um, creep, period_s)
    earliest = int(np.ceil(WARM_UP_S / period_s))
    steps = wave.steps[first_settled_step(quick_um, wave.steps, earliest) :]
    length = steps[2] - steps[0]
    runs = (steps[-1] - steps[0]) // length

    def fold(signal: FloatArray) -> FloatArray:
        signal = signal[steps[0] : steps[0] + runs * length]
        return signal.reshape(runs, length, *signal.shape[1:]).mean(axis=0)

    measured_um = fold(quick_um)
    drift = drift_basis(period_s * np.arange(quick_um.size, dtype=float), creep)
    return FastRecord(
        HeldInput(wave.level[steps[0] : steps[0] + length], period_s, is_periodic=True),
        np.arange(length), measured_um, fold(drift))


def _behind_hysteresis(parts: Sequence[Recording], creep: CreepDynamics) -> FastRecord:
    """Join recordings behind the hysteresis that is estimated from them."""
    loops = [
        FastLoops(np.asarray(part.voltage_v, dtype=float),
                  remove_creep(part.displacement_um, creep, part.sample_period_s),
                  drift_basis(part.time_s, creep), _first_kept(part), part.sample_period_s)
        for part in parts]
    found = hysteresis_with_dynamics(loops)
    entering = [found.entering_um(each) for each in loops]
    return project_out_slow_error(_record(parts, entering, creep))


def _record(
    parts: Sequence[Recording], inputs: Sequence[FloatArray], creep: CreepDynamics,
) -> FastRecord:
    """Join recordings with known inputs, from where the past of each no longer matters."""
    first_kept = [_first_kept(part) for part in parts]
    for part, first in zip(parts, first_kept, strict=True):
        remaining = part.voltage_v.size - LATE_ROWS - first
        if remaining < FEWEST_SAMPLES:
            raise ValueError(
                f"{part.path} has {max(remaining, 0)} samples after its start has settled, "
                f"fewer than {FEWEST_SAMPLES}: record the dynamics longer or faster")
    return joined_record(parts, inputs, first_kept, creep)


def _first_kept(part: Recording) -> int:
    """First sample whose response no longer depends on what came before the recording."""
    voltage_v = part.voltage_v
    range_v = float(np.ptp(voltage_v))
    moved = np.flatnonzero(np.abs(voltage_v - voltage_v[0]) > 1e-3 * range_v)
    rest = int(moved[0]) if moved.size else voltage_v.size
    # Only the end of a rest is used: its beginning may still ring after an earlier step.
    end = rest if rest >= AT_REST else min(LONGEST_LOOK, voltage_v.size)
    is_still = not rings(part, slice(max(0, end - LONGEST_LOOK), end))
    warm = max(0, rest - AT_REST) if is_still else round(WARM_UP_S / part.sample_period_s)
    near_v = NEAR_AN_EXTREME * range_v
    high = int(np.argmax(voltage_v >= voltage_v.max() - near_v))
    low = int(np.argmax(voltage_v <= voltage_v.min() + near_v))
    most = int(MOST_LEFT_OUT * voltage_v.size)
    first = min(warm, most)
    # The motion to the second of them began when the past no longer mattered. A first step of
    # another height than the later ones leaves all modes ringing; a smooth approach does not.
    reached = max(high, low)
    has_steps = np.abs(np.diff(voltage_v[: reached + 1])).max(initial=0.0) > near_v
    usual_s = USUAL_SETTLING_S if has_steps else 0.0
    if reached + round(usual_s / part.sample_period_s) <= most:
        settling_s = WARM_UP_S if has_steps and not _comes_back(part) else usual_s
        first = max(first, min(reached + round(settling_s / part.sample_period_s), most))
    return first


def _comes_back(part: Recording) -> bool:
    """Return whether later visits of the first level of a square wave end where the first ended.

    They seem not to if the stage rings for longer than a visit, which only costs some rows. Any
    other voltage returns True.
    """
    wave = two_levels(part)
    if wave is None:
        return True
    ends_um = [np.mean(part.displacement_um[max(0, step - AT_END) : step])
               for step in wave.steps[::2]]
    noise_um = noise_floor_um(part.displacement_um)
    return bool(np.abs(np.mean(ends_um) - ends_um[0]) <= STILL * noise_um)
