# SPDX-License-Identifier: BSD-3-Clause
"""Electric and vibration dynamics from any fast input: chirp, noise, steps, a free square wave.

What enters the dynamics is simulated, by a known hysteresis, by that of the recordings themselves,
or for two levels by offset and gain (4.5); the measured displacement is fitted to the response.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezo_common.arrays import FloatArray
from piezo_identification.conditioning.creep_removal import remove_creep
from piezo_identification.conditioning.waveforms import square_wave
from piezo_identification.estimators.dynamics.multisine import (
    LOWEST_LINE,
    FastSignals,
    poles_of_lines,
)
from piezo_identification.estimators.dynamics.output_error import fit_output_error
from piezo_identification.estimators.dynamics.square_wave import (
    WARM_UP_S,
    drift_basis,
    dynamics_of_poles,
    played_at_the_clock,
)
from piezo_identification.estimators.estimate import Estimate
from piezo_identification.estimators.hysteresis.density_fit import estimate_density
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import (
    CreepDynamics,
    ElectricVibrationDynamics,
    equilibrium_state,
    simulate_linear,
    zoh,
)
from piezo_recorder.reading.recording import Recording

TURNS = 4
"""Times that hysteresis and dynamics of the same recordings are fitted in turn, where neither is
known; the phase that one takes from the other is then small."""

LEVELS_IN_TURN, SMOOTHING_IN_TURN = 24, 1e-9
"""Grid and smoothing of a hysteresis that is only to drive the dynamics."""

AT_REST = 20
"""Samples without a change of the voltage, from which a recording counts as beginning at rest."""

MOST_LEFT_OUT = 0.4
"""Part of a recording that is left out at most, until its past no longer counts."""

NEAR_AN_EXTREME = 0.05
"""Once the voltage was within this part of its range from both ends, the past counts for no more
than an offset."""

LATE_ROWS = 2
"""Rows at the end that are left out, as what follows them is not known."""


@dataclass(frozen=True, eq=False)
class _Entering:
    """What enters the dynamics, and what is measured behind them, recordings one after another."""

    entering: FloatArray
    displacement_um: FloatArray
    fixed: FloatArray
    kept: NDArray[np.intp]
    sample_period_s: float
    longest: slice


def estimate_dynamics_any(
    recordings: Sequence[Recording], creep: CreepDynamics,
    hysteresis: PreisachModel | None = None, mode_count: int | None = None,
) -> Estimate:
    """Estimate electric lag and vibration modes (4.3) from recordings of any fast input.

    Parameters
    ----------
    recordings : sequence of Recording
        Without gaps, at the full sample clock and of one sample period. Each has an offset and an
        initial creep of its own.
    creep : CreepDynamics
    hysteresis : PreisachModel, optional
        If known, over the voltages of the recordings. By default that of the recordings, which is
        estimated in turn with the dynamics; of two levels, an offset and a gain.
    mode_count : int, optional
        By default as many as the Bayesian information criterion justifies.

    Returns
    -------
    Estimate
        Its model is an `ElectricVibrationDynamics`; its order counts modes.

    Raises
    ------
    ValueError
        If a recording has gaps, is averaged, leaves the hysteresis' range, or is too short.
    """
    parts = [played_at_the_clock(recording) for recording in recordings]
    if len({round(part.sample_period_s, 12) for part in parts}) > 1:
        raise ValueError(
            f"{parts[0].path} and {parts[1].path} differ in their sample periods: give recordings "
            "of the dynamics of one sample period")
    if all(_has_two_levels(part) for part in parts):
        fits = [_fit(parts, inputs, creep, mode_count) for inputs in _two_level_inputs(parts)]
        return min(fits, key=lambda fit: min(trial.information for trial in fit.trials))
    if hysteresis is not None:
        _check_range(parts, hysteresis)
        return _fit(parts, _through(hysteresis, parts), creep, mode_count)
    estimate = _fit(parts, [part.voltage_v for part in parts], creep, mode_count)
    for _ in range(TURNS):
        density = estimate_density(
            parts, creep, estimate.model, LEVELS_IN_TURN, 1, SMOOTHING_IN_TURN, 0.0)
        estimate = _fit(parts, _through(density.model(), parts), creep, mode_count)
    return estimate


def _through(hysteresis: PreisachModel, parts: Sequence[Recording]) -> list[FloatArray]:
    return [hysteresis.simulate(part.voltage_v) for part in parts]


def _check_range(parts: Sequence[Recording], hysteresis: PreisachModel) -> None:
    slack_v = 1e-6 * (hysteresis.voltage_max_v - hysteresis.voltage_min_v)
    for part in parts:
        low_v, high_v = part.voltage_v.min(), part.voltage_v.max()
        if low_v < hysteresis.voltage_min_v - slack_v or (
                high_v > hysteresis.voltage_max_v + slack_v):
            raise ValueError(
                f"{part.path} goes from {low_v:g} to {high_v:g} V, the hysteresis is known from "
                f"{hysteresis.voltage_min_v:g} to {hysteresis.voltage_max_v:g} V: identify it over "
                "a wider range")


def _has_two_levels(part: Recording) -> bool:
    try:
        return square_wave(part).steps.size > 0
    except ValueError:
        return False


def _two_level_inputs(parts: Sequence[Recording]) -> list[list[FloatArray]]:
    """Levels as sampled, and where a free-running generator explains them, with its own edges."""
    waves = [square_wave(part) for part in parts]
    sampled = [wave.level for wave in waves]
    own = [free_running_level(wave.level, wave.steps) for wave in waves]
    if any(level is None for level in own):
        return [sampled]
    return [sampled, [level for level in own if level is not None]]


def free_running_level(
    level: FloatArray, steps: NDArray[np.intp],
) -> FloatArray | None:
    """Return the mean level in each sample period, of a generator that does not know the samples.

    Parameters
    ----------
    level : ndarray, shape (N,)
        0 or 1, as sampled.
    steps : ndarray of int
        Samples at which it changes.

    Returns
    -------
    ndarray, shape (N,), or None
        None where one period and one duty do not explain the steps within a sample, or the period
        is a whole number of samples.
    """
    if steps.size < 6 or np.all(steps[2:] - steps[:-2] == steps[2] - steps[0]):
        return None
    turn = np.arange(steps.size)
    columns = np.column_stack([turn // 2, turn % 2 == 0, turn % 2 == 1]).astype(float)
    edges = columns @ np.linalg.lstsq(columns, steps.astype(float), rcond=None)[0]
    if np.abs(edges - steps).max() > 1.0:
        return None
    # A step that is seen at a sample happened within the sample period before, half of it ago.
    earlier = np.clip(steps - (edges - 0.5), 0.0, 1.0)
    result = level.copy()
    result[steps - 1] += earlier * (level[steps] - level[steps - 1])
    return result


def _fit(
    parts: Sequence[Recording], inputs: Sequence[FloatArray], creep: CreepDynamics,
    mode_count: int | None,
) -> Estimate:
    """Fit the dynamics of least output error behind known inputs."""
    signals = _joined(parts, inputs, creep)
    kept = signals.kept

    def respond(dynamics: ElectricVibrationDynamics) -> FloatArray:
        system = dynamics.state_space()
        initial = equilibrium_state(system, signals.entering[0])
        response = simulate_linear(
            zoh(system, signals.sample_period_s), signals.entering, initial)
        return response[kept]

    longest = FastSignals(
        signals.entering, signals.displacement_um, signals.fixed, signals.longest,
        signals.sample_period_s)

    def start(count: int) -> ElectricVibrationDynamics:
        return dynamics_of_poles(poles_of_lines(longest, 2 * count + 1, parts[0].path))

    return fit_output_error(
        respond, signals.displacement_um[kept], signals.fixed[kept], start, mode_count)


def _joined(
    parts: Sequence[Recording], inputs: Sequence[FloatArray], creep: CreepDynamics,
) -> _Entering:
    first, kept, blocks, longest = 0, [], [], slice(0, 0)
    for part in parts:
        begin, end = _first_kept(part), part.voltage_v.size - LATE_ROWS
        if end - begin < 20 * LOWEST_LINE:
            raise ValueError(
                f"{part.path} leaves {max(end - begin, 0)} samples after its start has settled, "
                f"fewer than {20 * LOWEST_LINE}: record the dynamics longer or faster")
        kept.append(np.arange(first + begin, first + end))
        blocks.append(drift_basis(part.time_s, creep))
        if end - begin > longest.stop - longest.start:
            longest = slice(first + begin, first + end)
        first += part.voltage_v.size
    width = blocks[0].shape[1]
    fixed = np.zeros((first, width * len(blocks)))
    row = 0
    for index, block in enumerate(blocks):
        fixed[row : row + len(block), index * width : (index + 1) * width] = block
        row += len(block)
    return _Entering(
        np.concatenate([np.asarray(each, dtype=float) for each in inputs]),
        np.concatenate([
            remove_creep(part.displacement_um, creep, part.sample_period_s) for part in parts]),
        fixed, np.concatenate(kept), parts[0].sample_period_s, longest)


def _first_kept(part: Recording) -> int:
    """First sample whose response no longer depends on what came before the recording."""
    voltage_v = part.voltage_v
    range_v = float(np.ptp(voltage_v))
    moved = np.flatnonzero(np.abs(voltage_v - voltage_v[0]) > 1e-3 * range_v)
    rest = int(moved[0]) if moved.size else voltage_v.size
    warm = 0 if rest >= AT_REST else round(WARM_UP_S / part.sample_period_s)
    near_v = NEAR_AN_EXTREME * range_v
    high = int(np.argmax(voltage_v >= voltage_v.max() - near_v))
    low = int(np.argmax(voltage_v <= voltage_v.min() + near_v))
    most = int(MOST_LEFT_OUT * voltage_v.size)
    past = max(high, low) - AT_REST
    return max(min(warm, most), past if 0 < past <= most else 0)
