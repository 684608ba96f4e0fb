# SPDX-License-Identifier: BSD-3-Clause
"""First-cycle remanence from a recording of the hysteresis that begins with the first rise."""

from dataclasses import replace

import numpy as np
from scipy.optimize import isotonic_regression

from piezo_common.arrays import BoolArray, FloatArray
from piezo_identification.conditioning.means import means_in_bins
from piezo_identification.conditioning.waveforms import (
    played,
    samples_per_mean,
    with_voltage_before,
)
from piezo_identification.simulation.past_search import NEAR_THE_END
from piezo_identification.simulation.sampled_response import SampledSystem
from piezo_models.hysteresis.first_rise import FirstRise
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.recording import Recording

CELLS = 24
"""Number of voltage cells between which the remanence is piecewise linear."""

LEAST_REMANENCE = 2e-3
"""Smallest remanence, relative to the displacement range, that is not noise, drift or creep."""

LARGEST_DRIFT = 0.2
"""Largest change of the displacement at the lowest voltage, relative to the remanence, after the
highest voltage was reached; drift continues, a remanence does not."""

LARGEST_ERROR_RATIO = 0.5
"""Largest ratio of the errors of the loops beyond noise, with and without the remanence. Drift or
unknown creep that looks like a remanence explains less."""


def estimate_first_rise(
    voltage_v: FloatArray, output_um: FloatArray, highest_v: float = -np.inf,
) -> FirstRise | None:
    """Estimate the remanence added by rises beyond all earlier voltages.

    A rise from the lowest voltage follows one curve, the Everett function of a cycled stage. Beyond
    the highest voltage so far, the remanence adds to it, and remains as an increased displacement
    at the lowest voltage afterwards.

    Input and output of the hysteresis, (N,), are without the linear dynamics, and the stage had
    reached `highest_v` before. The result is None if the recording does not return to its lowest
    voltage and rise again, shows no significant remanence, or continues to drift after the highest
    voltage was reached.
    """
    low_v, high_v = float(voltage_v.min()), float(voltage_v.max())
    at_low = voltage_v <= low_v + NEAR_THE_END * (high_v - low_v)
    begin = int(np.argmax(at_low))
    highest_v = max(highest_v, float(voltage_v[: begin + 1].max()))
    rises = _rises(voltage_v[begin:], output_um[begin:], at_low[begin:], highest_v)
    if len(rises) < 2:
        return None
    again = [np.column_stack([v, y - bottom])[v <= before]
             for v, y, bottom, before in rises]
    curve = np.concatenate(again)
    if curve.size == 0 or np.ptp(curve[:, 0]) < 0.5 * (high_v - low_v):
        return None
    edges_v = np.linspace(low_v, high_v, CELLS + 1)
    curve_v, curve_um = _cell_means(curve, edges_v)
    first_um = rises[0][2]
    shown = [np.array([[before, bottom - first_um] for *_, bottom, before in rises[1:]])]
    for v, y, _, before in rises:
        beyond = (v > before) & (v <= curve_v[-1])
        shown.append(np.column_stack(
            [v[beyond], y[beyond] - first_um - np.interp(v[beyond], curve_v, curve_um)]))
    points_v, points_um = _cell_means(np.concatenate(shown), edges_v)
    known = points_v > highest_v
    if not known.any():
        return None
    rising_um = np.maximum(isotonic_regression(points_um[known]).x, 0.0)
    start_v = min(max(low_v, highest_v), float(points_v[known][0]) - 1e-9 * (high_v - low_v))
    afterwards_um = [bottom for *_, bottom, before in rises if before >= curve_v[-1]]
    drift_um = np.ptp(afterwards_um) if afterwards_um else 0.0
    if rising_um[-1] < LEAST_REMANENCE * float(np.ptp(output_um)) or (
            drift_um > LARGEST_DRIFT * rising_um[-1]):
        return None
    return FirstRise((start_v, *points_v[known].tolist()), (0.0, *rising_um.tolist()))


def _rises(
    voltage_v: FloatArray, output_um: FloatArray, at_low: BoolArray, highest_v: float,
) -> list[tuple[FloatArray, FloatArray, float, float]]:
    """Voltages and outputs of each rise from the lowest voltage, its start, and the highest before.

    Only samples with a new highest voltage since the lowest one are included.
    """
    starts = np.flatnonzero(at_low[:-1] & ~at_low[1:]) + 1
    arrivals = np.flatnonzero(at_low & np.insert(~at_low[:-1], 0, True))
    rises = []
    for start, arrival in zip(starts, arrivals, strict=False):
        later = arrivals[arrivals > arrival]
        end = later[0] if later.size else voltage_v.size
        v, y = voltage_v[start:end], output_um[start:end]
        furthest = np.maximum.accumulate(v)
        new = v > np.insert(furthest[:-1], 0, -np.inf)
        rises.append((v[new], y[new], float(np.mean(output_um[arrival:start])), highest_v))
        highest_v = max(highest_v, float(furthest[-1]))
    return rises


def _cell_means(points: FloatArray, edges_v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean voltage and value of the points in each cell that has any."""
    number = np.clip(np.searchsorted(edges_v, points[:, 0]) - 1, 0, edges_v.size - 2)
    voltage_v, values = means_in_bins(number, *points.T)
    return voltage_v, values


def highest_before(recording: Recording) -> float:
    """Return the highest voltage of a recording before the played part; -inf if none."""
    before_v, lead = with_voltage_before(recording, played(recording))
    return float(before_v[:lead].max(initial=-np.inf))


def without_first_rise(
    recording: Recording, first_rise: FirstRise, creep: CreepDynamics,
    dynamics: ElectricVibrationDynamics, highest_v: float | None = None,
) -> Recording:
    """Return the played part of a recording as if the stage had been cycled before.

    The recording begins with the first rise, and the dynamics follow the hysteresis. The stage had
    reached `highest_v` before; by default the highest voltage that the recording shows.
    """
    part = played(recording)
    shown_v = highest_before(recording)
    missing_um = first_rise.simulate(
        part.voltage_v, shown_v if highest_v is None else max(highest_v, shown_v))
    behind = SampledSystem(creep.state_space() * dynamics.state_space(), part.sample_period_s,
                           samples_per_mean(part))
    return replace(part, displacement_um=part.displacement_um - behind.response(missing_um))
