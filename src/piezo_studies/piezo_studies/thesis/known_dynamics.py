# SPDX-License-Identifier: BSD-3-Clause
"""Section 4.6.1: creep, electric and vibration dynamics of a known plant from square waves."""

import numpy as np

from piezo_identification.estimators.creep.square_wave_creep import estimate_creep
from piezo_identification.estimators.dynamics.fast_estimate import WARM_UP_S, estimate_dynamics
from piezo_identification.fitting.parameter_sensitivities import sensitivity_systems
from piezo_models.linear.dynamics import equilibrium_state, simulate_linear, zoh
from piezo_studies.baselines.armax import fit_armax
from piezo_studies.thesis.figure_table import Row, Study
from piezo_studies.thesis.known_plant import HIGHEST_V, NOISE_UM, known_plant
from piezo_studies.thesis.laboratory import ROWS_LATE, record_model

CREEP_PERIOD_S, CREEP_SAMPLE_S, CREEP_PERIODS = 200.0, 0.02, 2
DYNAMICS_PERIOD_S, DYNAMICS_SAMPLE_S = 0.1, 1e-4
# After the start, they leave the 2000 points of the thesis.
DYNAMICS_PERIODS = 6
DRAWS = 7
SECTION = "4.6.1"


def square_wave(period_s, sample_period_s, periods):
    """Return the voltages of a square wave that begins at the upper level."""
    half = round(0.5 * period_s / sample_period_s)
    return np.tile(np.repeat([HIGHEST_V, 0.0], half), periods)


def study():
    """Compute the RMS errors of the parameters over the draws of the noise."""
    draws = np.array([errors_percent(seed) for seed in range(DRAWS)])
    slow, fast, armax, time_constant, frequency, damping = np.sqrt(np.mean(draws**2, axis=0))
    least = [f"no unbiased estimate of this record comes below {bound:.2g} % (Cramer-Rao)"
             for bound in least_errors_percent()]
    return Study([
        Row(SECTION, "error of the slow creep pole or zero", 3.0, slow, "%",
            f"RMS over {DRAWS} draws of the noise, as in all rows of 4.6.1", below=True),
        Row(SECTION, "error of the fast creep pole or zero", 3.0, fast, "%", below=True),
        Row(SECTION, "error of the slow creep pole, ARMAX (3, 4, 3)", 0.0, armax, "%",
            "straight from voltage to displacement, as in the thesis, whose 0.02 is rounded"),
        Row(SECTION, "error of the time constant", 1.6, time_constant, "%", least[0]),
        Row(SECTION, "error of the mode's frequency", 0.007, frequency, "%",
            f"{least[1]}; single draws come as near as the thesis' value"),
        Row(SECTION, "error of the damping", 1.1, damping, "%", least[2]),
    ])


def errors_percent(seed):
    """Return the errors (%) for one draw of the noise in the order of the table.

    For a pair of pole and zero, the larger error is returned.
    """
    plant = known_plant()
    slow = record_model("creep", plant, square_wave(CREEP_PERIOD_S, CREEP_SAMPLE_S, CREEP_PERIODS),
                        CREEP_SAMPLE_S, NOISE_UM, seed)
    quick = record_model(
        "dynamics", plant, square_wave(DYNAMICS_PERIOD_S, DYNAMICS_SAMPLE_S, DYNAMICS_PERIODS),
        DYNAMICS_SAMPLE_S, NOISE_UM, DRAWS + seed,
    )
    dynamics = estimate_dynamics(
        quick, estimate_creep(slow, pair_count=2).model, delay=ROWS_LATE).model
    creep = estimate_creep(slow, dynamics, pair_count=2).model
    dynamics = estimate_dynamics(quick, creep, mode_count=1, delay=ROWS_LATE).model
    true, found = plant.creep, creep
    pairs = [
        _percent((found.poles_rad_per_s[i], found.zeros_rad_per_s[i]),
                 (true.poles_rad_per_s[i], true.zeros_rad_per_s[i]))
        for i in range(2)
    ]
    return (
        *pairs,
        _percent(_armax_slow_pole(slow), true.poles_rad_per_s[0]),
        _percent(dynamics.time_constant_s, plant.dynamics.time_constant_s),
        _percent(dynamics.mode_frequencies_rad_per_s, plant.dynamics.mode_frequencies_rad_per_s),
        _percent(dynamics.damping_ratios, plant.dynamics.damping_ratios),
    )


def least_errors_percent():
    """Return the Cramer-Rao bounds (%) of time constant, frequency and damping.

    Gain and offset of the hysteresis are free, and the creep is known.
    """
    plant = known_plant()
    voltage_v = square_wave(DYNAMICS_PERIOD_S, DYNAMICS_SAMPLE_S, DYNAMICS_PERIODS)
    hysteresis_um = plant.hysteresis.simulate(voltage_v)
    used = slice(round(WARM_UP_S / DYNAMICS_SAMPLE_S), None)

    def response(system):
        held = zoh(system, DYNAMICS_SAMPLE_S)
        initial = equilibrium_state(system, hysteresis_um[0])
        return simulate_linear(held, hysteresis_um, initial)[used]

    linear = plant.linear()
    known = 2 * len(plant.creep.poles_rad_per_s)
    slopes = np.column_stack([
        response(sensitivity * linear)
        for sensitivity in sensitivity_systems(plant.creep, plant.dynamics)[known:]
    ])
    free = np.column_stack([np.ones(len(slopes)), response(linear)])
    slopes -= free @ np.linalg.lstsq(free, slopes, rcond=None)[0]
    return 100.0 * NOISE_UM * np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))


def _percent(found, true):
    """Return the largest relative error in percent."""
    return float(100.0 * np.max(np.abs(np.divide(found, true) - 1.0)))


def _armax_slow_pole(recording):
    armax = fit_armax(recording.voltage_v, recording.displacement_um, 3, 4, 3)
    slowest = np.abs(armax.poles()).max()
    return float(-np.log(slowest) / recording.sample_period_s)
