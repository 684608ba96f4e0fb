# SPDX-License-Identifier: BSD-3-Clause
"""Make recordings of a stage to try the offline tools on, as tables of a foreign logger.

    python examples/make_recordings.py runs/made

The stage is written down here with NumPy and SciPy, and shares no code with the models: the
hysteresis is a sum of play operators, the creep a relaxation of the displacement, and the vibration
that of a mass on a spring. So you know the truth, and may change it.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete, lfilter

MODE_HZ, DAMPING_RATIO = 780.0, 0.03
CREEP_PART, CREEP_S = 0.03, 20.0
PLAYS_V = np.linspace(0.0, 24.0, 481)  # half widths
GAINS_UM_PER_V = 0.005 * np.exp(-PLAYS_V / 3.0)
GAINS_UM_PER_V[0] = 0.15
HIGHEST_V = 100.0
NOISE_UM = 0.005


def displacement_um(voltage_v, sample_period_s, rng):
    """Return what the sensor measures just before each voltage acts, from rest at the first."""
    # The full range was swept once before: up to the highest voltage, and down to 0 V.
    plays = np.minimum(HIGHEST_V - PLAYS_V, PLAYS_V)
    hysteresis_um = np.empty(voltage_v.size)
    for n, volt in enumerate(voltage_v):
        plays = np.clip(plays, volt - PLAYS_V, volt + PLAYS_V)
        hysteresis_um[n] = GAINS_UM_PER_V @ plays
    hysteresis_um = np.concatenate([hysteresis_um[:1], hysteresis_um[:-1]])
    rest_um = hysteresis_um[0]
    keep = np.exp(-sample_period_s / CREEP_S)
    slow_um = lfilter([1.0 - keep], [1.0, -keep], hysteresis_um - rest_um)
    driven_um = hysteresis_um - rest_um + CREEP_PART * slow_um
    w = 2.0 * np.pi * MODE_HZ
    matrices = ([[0.0, 1.0], [-w * w, -2.0 * DAMPING_RATIO * w]], [[0.0], [w * w]],
                [[1.0, 0.0]], [[0.0]])
    a, b, c, *_ = cont2discrete(tuple(map(np.array, matrices)), sample_period_s)
    state = np.zeros(2)
    for n, drive in enumerate(driven_um.copy()):
        state = a @ state + b[:, 0] * drive
        driven_um[n] = c[0] @ state
    return driven_um + rest_um + NOISE_UM * rng.normal(size=voltage_v.size)


def voltages():
    """Return name, sample period (s) and voltage (V) of each recording."""
    half_period = 600
    creep_v = np.tile(np.repeat([80.0, 20.0], half_period), 2)
    dynamics_v = np.tile(np.repeat([60.0, 40.0], 400), 10)
    phase = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    cycle = 0.5 - 0.5 * np.cos(phase)
    hysteresis_v = HIGHEST_V * np.concatenate([part * cycle for part in np.linspace(0.2, 1.0, 5)])
    validation_v = 50.0 + 25.0 * np.sin(5 * phase) + 15.0 * np.sin(3 * phase + 1.0)
    return [("creep", 0.1, creep_v), ("dynamics", 2.5e-5, dynamics_v),
            ("hysteresis", 0.05, hysteresis_v),
            ("validation", 0.05, np.concatenate([np.linspace(0.0, validation_v[0], 100),
                                                 np.tile(validation_v, 2)]))]


def main(directory):
    """Write the tables: a time in ms, the voltage of a monitor, the displacement in nm."""
    directory.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(1)
    for name, period_s, voltage_v in voltages():
        measured_nm = 1e3 * displacement_um(voltage_v, period_s, rng)
        table = np.column_stack([1e3 * period_s * np.arange(voltage_v.size), voltage_v / 20.0,
                                 measured_nm])
        np.savetxt(directory / f"{name}.csv", table, fmt="%.9g", delimiter=";", comments="",
                   header="t [ms];monitor [V];position [nm]")
    print(f"written: {directory}/{{creep,dynamics,hysteresis,validation}}.csv")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "runs/made"))
