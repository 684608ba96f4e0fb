# SPDX-License-Identifier: BSD-3-Clause
"""A mass on a stiffening spring, integrated by SciPy, which a model has made up for by loops."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_by_scipy import logged
from scipy.integrate import solve_ivp

from piezo_identification.diagnosis.diagnose import diagnose
from piezo_identification.diagnosis.joint.competition import plain_model
from piezo_identification.prediction import predict
from piezo_models.cascade import StageModel
from piezo_models.effects.band_limited_voltage import BandLimitedVoltage
from piezo_models.hysteresis.preisach import PreisachModel
from piezo_models.linear.dynamics import CreepDynamics, ElectricVibrationDynamics
from piezo_recorder.sample_block import Flag

PERIOD_S, SAMPLES, NOISE_UM, GAIN_UM_PER_V = 1e-3, 1400, 1e-3, 0.5
MODE_RAD_PER_S, DAMPING_RATIO, CUBIC_PER_UM2 = 300.0, 0.05, 1e-4
FADED_IN_S = 0.3
LINES_HZ = np.arange(2.0, 120.0, 1.0)


@cache
def recording(seed, amplitude_v=20.0, cubic_per_um2=CUBIC_PER_UM2):
    """Return a multisine, smooth between its rows, and where the mass is at each of them."""
    generator = np.random.default_rng(seed)
    phases = generator.uniform(0.0, 2.0 * np.pi, LINES_HZ.size)

    def voltage_v(time_s):
        angles = np.multiply.outer(time_s, 2.0 * np.pi * LINES_HZ) + phases
        # It begins at rest.
        faded_in = 0.5 - 0.5 * np.cos(np.pi * np.minimum(time_s / FADED_IN_S, 1.0))
        return faded_in * amplitude_v * np.sqrt(2.0 / LINES_HZ.size) * np.cos(angles).sum(axis=-1)

    def moved(time_s, state):
        displacement_um, velocity = state
        force_um = GAIN_UM_PER_V * voltage_v(time_s) - displacement_um * (
            1.0 + cubic_per_um2 * displacement_um**2)
        return velocity, (MODE_RAD_PER_S**2 * force_um
                          - 2.0 * DAMPING_RATIO * MODE_RAD_PER_S * velocity)

    time_s = PERIOD_S * np.arange(SAMPLES)
    found = solve_ivp(moved, (0.0, time_s[-1]), (0.0, 0.0), "DOP853", time_s, rtol=1e-6, atol=1e-6)
    noise_um = NOISE_UM * generator.normal(size=SAMPLES)
    return logged(voltage_v(time_s), found.y[0] + noise_um, PERIOD_S, f"seed {seed}")


def model_with_loops():
    """Return a model as an identification without the spring leaves it."""
    density = np.tril(np.full((6, 6), 2e-4))
    loops = PreisachModel(-110.0, 110.0, density, -54.0, np.full(6, 0.4))
    modes = ElectricVibrationDynamics(5e-4, (MODE_RAD_PER_S, 900.0), (0.06, 0.7))
    return StageModel(loops, CreepDynamics((2.0,), (2.2,)), modes)


def error_um(model, unseen):
    prediction = predict(model, unseen)
    return np.std((prediction.measured_um - prediction.simulated_um)[prediction.good])


def test_a_line_and_a_mode_behind_a_smooth_voltage_are_found():
    linear = recording(1, cubic_per_um2=0.0)
    found = plain_model(model_with_loops(), [linear], [], error_um(model_with_loops(), linear))
    assert any(isinstance(effect, BandLimitedVoltage) for effect in found.effects)
    assert found.dynamics.mode_frequencies_rad_per_s[0] == pytest.approx(MODE_RAD_PER_S, rel=1e-3)
    assert found.dynamics.damping_ratios[0] == pytest.approx(DAMPING_RATIO, rel=1e-2)
    assert error_um(found, recording(2, cubic_per_um2=0.0)) < 3.0 * NOISE_UM


def behind_a_slow_approach(measured, rows=20, slower=10):
    """Return a recording as the stage makes it, whose approach has a longer sample period."""
    return replace(
        measured, sample_index=np.r_[slower * np.arange(rows), slower * rows
                                     + measured.sample_index],
        sample_periods_s=np.r_[np.full(rows, slower * PERIOD_S), measured.sample_periods_s],
        voltage_v=np.r_[np.zeros(rows), measured.voltage_v],
        displacement_um=np.r_[np.zeros(rows), measured.displacement_um],
        flags=np.r_[np.full(rows, Flag.PLAYING | Flag.RAMPING, dtype=np.uint32), measured.flags])


def test_parts_of_a_recording_may_have_other_sample_periods():
    linear = recording(1, cubic_per_um2=0.0)
    left_um = error_um(model_with_loops(), linear)
    found = plain_model(model_with_loops(), [behind_a_slow_approach(linear)], [], left_um)
    assert found.dynamics.mode_frequencies_rad_per_s[0] == pytest.approx(MODE_RAD_PER_S, rel=1e-3)


def test_there_is_none_where_the_given_model_leaves_far_less():
    assert plain_model(model_with_loops(), [recording(1)], [], NOISE_UM) is None


def test_there_is_none_where_loops_explain_the_old_recordings():
    model, new = model_with_loops(), recording(1)
    old = replace(new, displacement_um=model.simulate(new.voltage_v, PERIOD_S))
    assert plain_model(model, [new], [], error_um(model, new)) is not None
    assert plain_model(model, [new], [old], error_um(model, new)) is None


@pytest.mark.long
def test_a_spring_that_loops_stand_for_is_named_and_predicts_larger_motion():
    given = model_with_loops()
    diagnosis = diagnose(given, [recording(1)])
    assert [entry["name"] for entry in diagnosis.effects] == ["stiffening"]
    larger = recording(3, amplitude_v=26.0)
    assert error_um(diagnosis.model, larger) < 0.01 * error_um(given, larger)
