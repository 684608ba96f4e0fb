# SPDX-License-Identifier: BSD-3-Clause
"""Section 4.6.1: creep, electric and vibration dynamics of a known plant from square waves."""

import numpy as np

from piezo_bringup.reproduction.known_plant import HIGHEST_V, NOISE_UM, known_plant
from piezo_bringup.reproduction.laboratory import record_model
from piezo_bringup.reproduction.table import Row, Study
from piezo_identification.armax import fit_armax
from piezo_identification.creep import estimate_creep
from piezo_identification.dynamics import estimate_dynamics

CREEP_PERIOD_S, CREEP_SAMPLE_S, CREEP_PERIODS = 200.0, 0.02, 2
DYNAMICS_PERIOD_S, DYNAMICS_SAMPLE_S = 0.1, 1e-4
# Of these the 2000 points of the thesis are used, once the start is over.
DYNAMICS_PERIODS = 6
SECTION = "4.6.1"


def square_wave(period_s, sample_period_s, periods):
    """Voltages that begin at the upper level."""
    half = round(0.5 * period_s / sample_period_s)
    return np.tile(np.repeat([HIGHEST_V, 0.0], half), periods)


def study():
    """Errors of the parameters.

    Returns
    -------
    Study
    """
    plant = known_plant()
    slow = record_model("creep", plant, square_wave(CREEP_PERIOD_S, CREEP_SAMPLE_S, CREEP_PERIODS),
                        CREEP_SAMPLE_S, NOISE_UM)
    quick = record_model(
        "dynamics", plant, square_wave(DYNAMICS_PERIOD_S, DYNAMICS_SAMPLE_S, DYNAMICS_PERIODS),
        DYNAMICS_SAMPLE_S, NOISE_UM,
    )
    creep = estimate_creep(slow, pair_count=2).model
    dynamics = estimate_dynamics(quick, creep, mode_count=1).model
    creep = estimate_creep(slow, dynamics, pair_count=2).model
    dynamics = estimate_dynamics(quick, creep).model

    def percent(found, true):
        return float(100.0 * np.max(np.abs(np.divide(found, true) - 1.0)))

    pairs = [
        percent((creep.poles_rad_per_s[i], creep.zeros_rad_per_s[i]),
                (plant.creep.poles_rad_per_s[i], plant.creep.zeros_rad_per_s[i]))
        for i in range(2)
    ]
    true = plant.dynamics
    rows = [
        Row(SECTION, "error of the slow creep pole and zero", 3.0, pairs[0], "%",
            "the larger of the two; output-error fit", below=True),
        Row(SECTION, "error of the fast creep pole and zero", 3.0, pairs[1], "%",
            below=True),
        Row(SECTION, "error of the slow creep pole, ARMAX (3, 4, 3)", 0.0,
            percent(_armax_slow_pole(slow), plant.creep.poles_rad_per_s[0]), "%",
            "straight from voltage to displacement, as in the thesis"),
        Row(SECTION, "error of the time constant", 1.6,
            percent(dynamics.time_constant_s, true.time_constant_s), "%"),
        Row(SECTION, "error of the mode's frequency", 0.007,
            percent(dynamics.mode_frequencies_rad_per_s, true.mode_frequencies_rad_per_s), "%",
            "one draw of the noise: the fit's standard deviation is of this size"),
        Row(SECTION, "error of the damping", 1.1,
            percent(dynamics.damping_ratios, true.damping_ratios), "%"),
    ]
    return Study(rows)


def _armax_slow_pole(recording):
    armax = fit_armax(recording.voltage_v, recording.displacement_um, 3, 4, 3)
    slowest = np.abs(armax.poles()).max()
    return float(-np.log(slowest) / recording.sample_period_s)
