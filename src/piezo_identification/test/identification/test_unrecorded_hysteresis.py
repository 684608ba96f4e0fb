# SPDX-License-Identifier: BSD-3-Clause
"""Fast records of a stage whose hysteresis was not recorded, of plays in place of relays."""

from functools import partial

import numpy as np
import pytest
from scipy.signal import chirp

from piezo_identification.estimators.hysteresis.fast_loops import FastLoops, LoopRegression
from piezo_identification.estimators.hysteresis.loops_with_dynamics import hysteresis_with_dynamics
from piezo_identification.identification.identify import identify
from piezo_models.linear.dynamics import ElectricVibrationDynamics

PERIOD_S, COUNT = 1e-4, 8000
TRUTH = ElectricVibrationDynamics(4e-4, (3000.0,), (0.05,))


def voltage_of(kind):
    time_s = np.arange(COUNT) * PERIOD_S
    random = np.random.default_rng(4)
    if kind == "chirp":
        return 40.0 + 30.0 * chirp(time_s, 5.0, time_s[-1], 900.0)
    if kind == "multisine":
        phases = random.uniform(0.0, 2.0 * np.pi, 40)
        tones = 2.0 * np.pi * 20.0 * np.arange(1, 41)
        return 40.0 + 4.0 * np.sin(np.outer(time_s, tones) + phases).sum(axis=1)
    return np.clip(40.0 + 10.0 * random.normal(size=COUNT // 4), 0.0, 80.0).repeat(4)


def error_of(dynamics):
    """Largest relative error of the response up to the mode and beyond."""
    frequency_hz = np.linspace(1.0, 900.0, 60)
    truth = TRUTH.response(frequency_hz)
    return np.abs(dynamics.response(frequency_hz) - truth).max() / np.abs(truth).max()


@pytest.mark.parametrize("kind", [
    "noise", *(pytest.param(kind, marks=pytest.mark.long) for kind in ("chirp", "multisine"))])
def test_dynamics_and_hysteresis_are_told_apart_in_one_record(kind, foreign_stage, record):
    stage = foreign_stage((), 4e-4, 3000.0, 0.05)
    recording = record(stage, voltage_of(kind), PERIOD_S, noise_um=0.01)
    loops = FastLoops(
        recording.voltage_v, recording.displacement_um, np.ones((COUNT, 1)), 3000, PERIOD_S)
    found = hysteresis_with_dynamics([loops])
    hysteresis = found.hysteresis
    assert error_of(found.dynamics) < 3e-3
    assert abs(found.delay_s) < 0.01 * PERIOD_S
    inside_v = np.clip(
        40.0 - 25.0 * np.cos(np.linspace(0.0, 20.0, 2000)), *np.quantile(loops.voltage_v, [0, 1]))
    truth_um = stage.hysteresis(inside_v)
    error_um = (hysteresis.simulate(inside_v) - truth_um)[600:]
    assert np.std(error_um) < 0.02 * np.ptp(truth_um)


@pytest.fixture(scope="module")
def dithered():
    """A growing sine with a dither of random steps and ramps, after a rest."""
    time_s, random = np.arange(10_000) * PERIOD_S, np.random.default_rng(5)
    dither_v = np.cumsum(random.choice([-1.0, 0.0, 1.0], 5000)) + 4.0 * random.choice(
        [-1.0, 1.0], 250).repeat(20)
    dither_v -= np.convolve(dither_v, np.ones(200) / 200.0, "same")
    moving = time_s >= 0.5
    voltage_v = 30.0 + np.where(
        moving, 60.0 * (time_s - 0.4) * np.sin(31.4 * (time_s - 0.5)), 0.0)
    voltage_v[moving] += dither_v
    return voltage_v


@pytest.mark.long
def test_what_a_slow_sweep_came_from_is_found(dithered, foreign_stage, record):
    """The amplitude grows, so loops that are not yet closed show how the first voltage came."""
    recording = record(foreign_stage((), 4e-4, 4660.0, 0.02), dithered, PERIOD_S, noise_um=0.001)
    loops = FastLoops(dithered, recording.displacement_um, np.ones((10_000, 1)), 4980, PERIOD_S)
    found = hysteresis_with_dynamics([loops])
    # The plays of this stage come down from far above.
    assert found.past == "falling"
    assert found.dynamics.mode_frequencies_rad_per_s == pytest.approx((4660.0,), rel=1e-3)
    assert found.dynamics.damping_ratios == pytest.approx((0.02,), rel=0.02)
    assert found.dynamics.time_constant_s == pytest.approx(4e-4, rel=0.05)


@pytest.mark.long
def test_a_slow_sweep_with_a_dither_shows_hysteresis_and_mode(dithered, foreign_stage, record):
    recording = record(foreign_stage((), 4e-4, 4660.0, 0.02), dithered, PERIOD_S, noise_um=0.001)
    # The voltage stepped just before: the stage still rings when the recording begins.
    time_s = np.arange(dithered.size) * PERIOD_S
    ringing_um = np.exp(-93.0 * time_s) * np.cos(4660.0 * time_s)
    object.__setattr__(recording, "displacement_um", recording.displacement_um + ringing_um)
    identified = identify(dynamics=recording)
    dynamics = identified.model.dynamics
    assert dynamics.mode_frequencies_rad_per_s == pytest.approx((4660.0,), rel=1e-3)
    assert dynamics.damping_ratios == pytest.approx((0.02,), rel=0.02)
    # A fit of voltage to displacement takes a slow mode for the loops, and leaves nearly all.
    assert identified.adequacy["dynamics"]["e_y_percent"] < 2.0


def test_parameters_of_dynamics_and_of_an_everett_value_move_the_residual_as_its_slopes_say(
        foreign_stage, record):
    recording = record(foreign_stage((), 4e-4, 3000.0, 0.05), voltage_of("noise"), PERIOD_S)
    regression = LoopRegression([FastLoops(
        recording.voltage_v, recording.displacement_um, np.ones((COUNT, 1)), 3000, PERIOD_S)])

    def response(value, frequency_hz):
        return ElectricVibrationDynamics(4e-4, (value,), (0.05,)).response(frequency_hz)

    step = 1.0
    fits = [regression.fit(partial(response, 2990.0 + by)) for by in (-step, 0.0, step)]
    slopes = regression.slopes(fits[1], lambda frequency_hz: (
        response(2990.0 + step, frequency_hz) - response(2990.0 - step, frequency_hz))[None] / (
            2.0 * step))
    # Kaufman's Jacobian has the gradient of the cost exactly.
    by_steps = (fits[2].cost - fits[0].cost) / (2.0 * step)
    assert 2.0 * slopes[:, 0] @ fits[1].residual == pytest.approx(by_steps, rel=1e-3)
