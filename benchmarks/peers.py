# SPDX-License-Identifier: BSD-3-Clause
"""Compare identification with public libraries on the same data: python peers.py.

Dynamics: public libraries fit square-wave records of a known plant. Hysteresis: the dense
regression on the relay grid is solved by NumPy's singular value decomposition.
"""

import json
import os
import subprocess
import time
from pathlib import Path
from statistics import median

import numpy as np
from hysteresis_speed import voltages
from peer_dynamics import METHODS
from stage_model import VOLTAGE_RANGE_V, preisach_model
from table import Measurements, show

from piezo_identification.estimators.hysteresis.smoothed_density import smoothed_density
from piezo_identification.experiments.input_designs import stair_amplitudes, stair_harmonics
from piezo_models.linear.dynamics import (
    ElectricVibrationDynamics,
    simulate_linear,
    zoh,
    zoh_response,
)
from piezo_studies.baselines.armax import fit_armax
from piezo_studies.baselines.relay_grid import activation_matrix
from piezo_studies.baselines.sampling_rules import sample_by_voltage

ROOT = Path(__file__).parents[1]
OUTPUT = ROOT / "runs" / "bench" / "peers"
PEERS_PYTHON = ROOT / ".venv-peers" / "bin" / "python"

PLANT = ElectricVibrationDynamics(0.001, (3000.0,), (0.1,))
"""Of thesis section 4.6."""
SWING_UM = 8.75
SAMPLE_PERIOD_S = 1e-4
HALF_PERIOD = 500
PERIODS = 2
NOISES_UM = (0.07, 0.009)
SEEDS = 10
FREQUENCY_HZ = np.geomspace(10.0, 1000.0, 40)
"""The band in which the square wave has power: from its fundamental to twice the resonance."""
SUCCESS = 0.01
"""Largest relative error of the response, root mean square over the band."""
TIME_LIMIT_S = 10.0
"""After which a method begins no further record."""

LEVELS = 60
FINE_LEVELS = 120
TRUE_LEVELS = 200
SAMPLES_PER_HARMONIC = 500
HYSTERESIS_NOISE_UM = 0.009
UNSEEN_SAMPLES = 2000
SVD_CUTOFFS = {"all values": 1e-12, "values above 1e-3": 1e-3}


def measure(rows):
    """Add everything to the measurements."""
    dynamics(rows)
    hysteresis(rows)


def dynamics(rows):
    """Add successes, errors and times of the fits to square waves."""
    OUTPUT.mkdir(parents=True, exist_ok=True)
    wave = np.tile(np.repeat([0.5, -0.5], HALF_PERIOD), PERIODS)
    clean_um = SWING_UM * simulate_linear(zoh(PLANT.state_space(), SAMPLE_PERIOD_S), wave)
    truth = SWING_UM * zoh_response(PLANT.state_space(), FREQUENCY_HZ, SAMPLE_PERIOD_S)
    for noise_um in NOISES_UM:
        outputs_um = np.array([
            clean_um + noise_um * np.random.default_rng(seed).normal(size=clean_um.size)
            for seed in range(SEEDS)])
        title = f"dynamics, {1000 * noise_um:.0f} nm"
        our_fits = _fit_ours(wave, outputs_um)
        ours = _Fits(our_fits, truth)
        rows[f"{title}: successes", "%"].append(100.0 * ours.success)
        rows[f"{title}: median error", "%"].append(100.0 * ours.error)
        rows[f"{title}: time of a fit", "ms"].append(1000.0 * ours.time_s)
        records = OUTPUT / "records.npz"
        np.savez(records, input=wave, outputs=outputs_um, frequency_hz=FREQUENCY_HZ,
                 sample_period_s=SAMPLE_PERIOD_S, time_limit_s=TIME_LIMIT_S)
        for method in METHODS:
            _add_peer(rows, title, method, records, truth, our_fits)


def _add_peer(rows, title, method, records, truth, our_fits):
    """Add what a peer reaches, as a ratio to ours, or why it reaches nothing."""
    keys = [(f"{title}: {method} over ours, {what}", "times")
            for what in ("successes", "error", "time")]
    try:
        content = _run_peer(method, records)
    except RuntimeError as error:
        rows[keys[0]] = []
        rows.remarks[keys[0][0]] = str(error)
        return
    peer = _Fits(content["fits"], truth)
    # Beside ours of the same records.
    ours = _Fits(our_fits[: len(peer.times_s)], truth)
    for key, value in zip(keys, (peer.success / ours.success, peer.error / ours.error,
                                 peer.time_s / ours.time_s), strict=True):
        # Of a method that finds no model there is no error.
        rows[key] += [value] if np.isfinite(value) else []
    told = [f"version {content['version']}"]
    if len(peer.times_s) < SEEDS:
        told.append(f"{len(peer.times_s)} of {SEEDS} records in {TIME_LIMIT_S:g} s")
    if peer.failures:
        told.append(f"{len(peer.failures)} raised {peer.failures[0][:60]}")
    rows.remarks[keys[0][0]] = ", ".join(told)


def _fit_ours(wave, outputs_um):
    """Return the fits in the form of `peer_dynamics.fit_all`."""
    fits = []
    for output_um in outputs_um:
        start_s = time.perf_counter()
        armax = fit_armax(wave, output_um, 3, 3, 3)
        time_s = time.perf_counter() - start_s
        response = armax.response(FREQUENCY_HZ, SAMPLE_PERIOD_S)
        fits.append({"time_s": time_s, "response": [response.real, response.imag]})
    return fits


def _run_peer(method, records):
    """Return the result of a method of `peer_dynamics`; RuntimeError tells why there is none."""
    if not PEERS_PYTHON.exists():
        raise RuntimeError("not measured: tools/apart could not install it")
    result = OUTPUT / "result.json"
    result.unlink(missing_ok=True)
    command = [PEERS_PYTHON, Path(__file__).with_name("peer_dynamics.py"), method, records, result]
    # Nothing of this environment may reach into that of the peers.
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    run = subprocess.run(command, env=environment, stdout=subprocess.DEVNULL,
                         stderr=subprocess.PIPE, text=True, errors="replace")
    if not result.exists():
        last = (run.stderr.strip().splitlines() or [f"ended with {run.returncode}"])[-1]
        raise RuntimeError(f"not measured: {last[:80]}")
    return json.loads(result.read_text(encoding="utf-8"))


class _Fits:
    """Success rate, median error and median time of the fits of one method."""

    def __init__(self, fits, truth):
        self.times_s = [fit["time_s"] for fit in fits]
        self.failures = [fit["error"] for fit in fits if "error" in fit]
        errors = np.full(len(fits), np.inf)
        for n, fit in enumerate(fits):
            if "response" in fit:
                real, imaginary = map(np.asarray, fit["response"])
                off = np.linalg.norm(real + 1j * imaginary - truth) / np.linalg.norm(truth)
                errors[n] = off if np.isfinite(off) else np.inf
        self.success = float(np.mean(errors <= SUCCESS))
        self.error = float(np.median(errors))
        self.time_s = median(self.times_s)


def hysteresis(rows):
    """Add errors on unseen voltages and times of the fits of the density."""
    lowest_v, highest_v = VOLTAGE_RANGE_V
    levels_v = np.linspace(lowest_v, highest_v, LEVELS + 1)
    time_s = np.arange(LEVELS * SAMPLES_PER_HARMONIC + 1) / SAMPLES_PER_HARMONIC
    amplitudes_v = stair_amplitudes(LEVELS, highest_v - lowest_v)
    voltage_v = lowest_v + stair_harmonics(time_s, amplitudes_v, 1.0)
    plant = preisach_model(TRUE_LEVELS)
    noise = np.random.default_rng(0).normal(size=voltage_v.size)
    output_um = plant.simulate(voltage_v) + HYSTERESIS_NOISE_UM * noise
    samples = sample_by_voltage(voltage_v, levels_v)
    unseen_v = np.append(lowest_v, voltages(UNSEEN_SAMPLES))
    unseen_um = plant.simulate(unseen_v)

    def percent_of_range(predicted_um):
        return 100.0 * np.sqrt(np.mean((predicted_um - unseen_um) ** 2)) / np.ptp(unseen_um)

    # What is compiled at the first call is not of the method.
    unseen_areas = with_offset(activation_matrix(unseen_v, levels_v))
    smoothed_density(voltage_v[::20], output_um[::20], levels_v[::4], smoothing_weight=1e-10)
    dense = {}
    for name, cutoff in SVD_CUTOFFS.items():
        values, time_s = _timed(lambda cutoff=cutoff: density_by_numpy(
            voltage_v, output_um, levels_v, samples, cutoff))
        dense[f"NumPy SVD, {LEVELS} levels, {name}"] = (
            percent_of_range(unseen_areas @ values), time_s)
    # On the same samples and cells, and as the structure allows: every sample, finer cells.
    for count, chosen in ((LEVELS, samples), (FINE_LEVELS, None)):
        edges_v = np.linspace(lowest_v, highest_v, count + 1)
        model, ours_s = _timed(lambda edges_v=edges_v, chosen=chosen: smoothed_density(
            voltage_v, output_um, edges_v, chosen).model())
        ours = percent_of_range(model.simulate(unseen_v))
        title = f"density, {count} levels"
        rows[f"{title}: error on unseen voltages", "% of range"].append(ours)
        rows[f"{title}: time of a fit", "ms"].append(1000.0 * ours_s)
        for name, (error, time_s) in dense.items():
            rows[f"{title}: {name} over ours, error", "times"].append(error / ours)
            rows[f"{title}: {name} over ours, time", "times"].append(time_s / ours_s)


def density_by_numpy(voltage_v, output_um, levels_v, samples, cutoff):
    """Densities of the cells and the offset, from the dense regression on the relay grid."""
    areas = with_offset(activation_matrix(voltage_v, levels_v, samples))
    return np.linalg.pinv(areas, rcond=cutoff) @ output_um[samples]


def with_offset(areas):
    """Return the regression with a column of ones."""
    return np.column_stack([areas, np.ones(len(areas))])


def _timed(function):
    """Return the result and the time (s) of a call."""
    start_s = time.perf_counter()
    return function(), time.perf_counter() - start_s


def main():
    """Measure this section alone."""
    rows = Measurements()
    measure(rows)
    show(rows.table())


if __name__ == "__main__":
    main()
