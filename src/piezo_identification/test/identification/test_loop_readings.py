# SPDX-License-Identifier: BSD-3-Clause
"""Points of a static loop are read at rest at their voltage, unless they show otherwise."""

import numpy as np
import pytest

from piezo_identification.conditioning.row_alignment import rows_read_at_start
from piezo_identification.estimators.estimate import creep_of_partial_fractions
from piezo_identification.estimators.hysteresis.density_fit import hysteresis_output_um
from piezo_identification.identification.linear_dynamics import LinearDynamics
from piezo_identification.identification.row_delays import found_readings
from piezo_models.linear.dynamics import ElectricVibrationDynamics

CORNERS_V = (0.0, 100.0, 20.0, 80.0, 40.0, 100.0, 0.0)
CYCLED_V = np.concatenate([np.linspace(0.0, 100.0, 20), np.linspace(100.0, 0.0, 20)])
FAST = ElectricVibrationDynamics(3e-4, (4000.0,), (0.02,))


def ways(points):
    """Ways between the corners, in so many points each."""
    parts = [np.linspace(low, high, points, endpoint=False)
             for low, high in zip(CORNERS_V[:-1], CORNERS_V[1:], strict=True)]
    return np.append(np.concatenate(parts), CORNERS_V[-1])


def read_at(voltage_v, displacement_um, period_s, recorded, dynamics=FAST):
    points = recorded("points", voltage_v, displacement_um, period_s, 0.004)
    return found_readings({"hysteresis": points}, LinearDynamics(dynamics=dynamics))["hysteresis"]


@pytest.mark.parametrize("at_rest", [True, False])
def test_a_point_is_read_where_it_makes_a_loop(at_rest, independent_stage, recorded):
    voltage_v = ways(11)
    stage = independent_stage((), ())
    displacement_um = stage.displacement_um(voltage_v, 2.0, past_v=CYCLED_V)
    if not at_rest:
        displacement_um = np.append(displacement_um[0], displacement_um[:-1])
    assert read_at(voltage_v, displacement_um, 2.0, recorded) == float(at_rest)


def test_rows_that_move_little_and_stages_without_dynamics_are_as_they_are(
        independent_stage, recorded):
    stage = independent_stage((), ())
    for count, dynamics in ((200, FAST), (11, ElectricVibrationDynamics())):
        voltage_v = ways(count)
        displacement_um = stage.displacement_um(voltage_v, 2.0, past_v=CYCLED_V)
        assert read_at(voltage_v, displacement_um, 2.0, recorded, dynamics) == 0.0


def test_what_points_hold_is_found_though_creep_goes_on_while_they_are_held(
        independent_stage, recorded):
    """Held for 2 s each, while the fastest creep takes half a second."""
    rates, gains, fine = np.array([0.05, 2.0]), np.array([0.03, 0.04]), 40
    voltage_v = ways(7)
    stage = independent_stage(rates, gains)
    displacement_um = stage.displacement_um(np.repeat(voltage_v, fine), 2.0 / fine)
    # Of the row in which the next voltage begins, and so not yet acts.
    creep_um = displacement_um - stage.hysteresis_um(np.repeat(voltage_v, fine))
    held_um = stage.hysteresis_um(voltage_v)
    read_um = held_um[:-1] + creep_um[fine::fine]
    points = recorded("points", voltage_v[:-1], read_um, 2.0)
    creep, _ = creep_of_partial_fractions(rates, gains)
    found_um = hysteresis_output_um(rows_read_at_start(points, 1.0), creep, FAST)
    np.testing.assert_allclose(found_um[:-1], held_um[1:-2], atol=1e-9)


def test_loops_are_read_with_their_voltage_where_wrong_dynamics_tell_nothing(
        independent_stage, recorded):
    """Dynamics a thousand times too slow leave micrometres, however the rows are read."""
    voltage_v = ways(100)
    displacement_um = independent_stage((), ()).displacement_um(voltage_v, 0.02, past_v=CYCLED_V)
    loops = recorded("loops", voltage_v, displacement_um, 0.02, 0.004)
    wrong = LinearDynamics(dynamics=ElectricVibrationDynamics(0.5), read_at_samples=0.1)
    assert found_readings({"hysteresis": loops}, wrong)["hysteresis"] == 0.0


def test_slow_rows_do_not_share_a_reading_behind_their_hold(independent_stage, recorded):
    found = LinearDynamics(dynamics=FAST, read_at_samples=1.4)
    voltage_v = ways(100)
    displacement_um = independent_stage((), ()).displacement_um(voltage_v, 0.02, past_v=CYCLED_V)
    at_end_um = np.append(displacement_um[0], displacement_um[:-1])
    loops = recorded("loops", voltage_v, at_end_um, 0.02)
    assert found.shared_reading == 1.0
    assert found_readings({"hysteresis": loops}, found)["hysteresis"] == 0.0
