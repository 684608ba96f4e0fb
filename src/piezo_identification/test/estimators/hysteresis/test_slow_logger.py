# SPDX-License-Identifier: BSD-3-Clause
"""A logger far slower than the stage: each displacement is that of the voltage before, whole."""

import numpy as np

from piezo_identification.estimators.hysteresis.density_fit import (
    estimate_density,
    hysteresis_output_um,
)
from piezo_models import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.reading.memory import recording_of

HALF_WIDTHS_V = np.linspace(0.0, 24.0, 241)
GAINS_UM_PER_V = 0.01 * np.exp(-HALF_WIDTHS_V / 3.0)


def test_loops_of_plays_are_found_behind_dynamics_faster_than_the_logger():
    cycle = 0.5 - 0.5 * np.cos(np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False))
    voltage_v = 100.0 * np.concatenate([part * cycle for part in (0.2, 0.4, 0.6, 0.8, 1.0)])
    plays, hysteresis_um = HALF_WIDTHS_V.copy(), np.empty(voltage_v.size)
    for n, volt in enumerate(voltage_v):
        plays = np.clip(plays, volt - HALF_WIDTHS_V, volt + HALF_WIDTHS_V)
        hysteresis_um[n] = GAINS_UM_PER_V @ plays
    # At each row, the stage has long settled at the voltage that was held until then.
    measured_um = np.concatenate([hysteresis_um[:1], hysteresis_um[:-1]])
    recording = recording_of({"time_s": 0.05 * np.arange(voltage_v.size), "voltage_v": voltage_v,
                              "displacement_um": measured_um})
    found = estimate_density(
        recording, CreepDynamics(), ElectricVibrationDynamics(1e-5, (4900.0,), (0.3,)), 60, 1,
        smoothing_weight=1e-12, translation_weight=1e-6)
    left_um = found.model().simulate(voltage_v) - hysteresis_um
    assert np.std(left_um) < 5e-4 * np.ptp(hysteresis_um)


def test_corners_where_the_voltage_turns_are_kept(recorded):
    """A few points far between: a slope through them would cut the corners by half a step."""
    voltage_v = np.interp(np.arange(37), [0, 10, 18, 24, 28, 36], [0, 100, 20, 80, 40, 0])
    measured_um = 0.1 * np.append(voltage_v[0], voltage_v[:-1])
    output_um = hysteresis_output_um(
        recorded("points", voltage_v, measured_um, 1.0), CreepDynamics(),
        ElectricVibrationDynamics(4e-4, (3900.0,), (0.02,)))
    np.testing.assert_allclose(output_um, 0.1 * voltage_v, atol=1e-6)
