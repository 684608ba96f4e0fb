# SPDX-License-Identifier: BSD-3-Clause
"""Creep in closed form that is faster than the rows of its recording is not reported."""

import numpy as np
import pytest

from piezo_identification.estimators.creep.slow_creep import (
    _Problem,
    estimate_slow_creep,
)
from piezo_identification.estimators.creep.square_wave_creep import estimate_creep
from piezo_identification.estimators.estimate import ROWS_OF_DECAY
from piezo_recorder.reading.recording import Recording
from piezo_recorder.sample_block import Flag

PERIOD_S, NOISE_UM = 0.05, 0.001
SLOW_RAD_PER_S, PART = 0.1, 0.05
LEVELS_V = (20.0, 80.0, 20.0, 80.0, 20.0)


def recording(fast_rad_per_s, fast_part=PART):
    """Steps of a linear stage with two exponentials of creep, read when the row begins."""
    voltage_v = np.repeat(LEVELS_V, 1200)
    time_s = np.arange(voltage_v.size) * PERIOD_S
    displacement_um = np.append(voltage_v[0], voltage_v[:-1])
    for rate, part in ((SLOW_RAD_PER_S, PART), (fast_rad_per_s, fast_part)):
        crept = np.full(voltage_v.size, LEVELS_V[0])
        for number, (before, after) in enumerate(zip(LEVELS_V[:-1], LEVELS_V[1:], strict=True), 1):
            since = np.maximum(time_s - 1200 * number * PERIOD_S, 0.0)
            crept -= (after - before) * np.expm1(-rate * since)
        displacement_um = displacement_um + part * crept
    noise = np.random.default_rng(1).normal(size=voltage_v.size)
    return Recording(
        "closed form", 1.0 / PERIOD_S, np.arange(voltage_v.size),
        np.full(voltage_v.size, PERIOD_S), voltage_v, 0.1 * displacement_um + NOISE_UM * noise,
        np.full(voltage_v.size, Flag.PLAYING, dtype=np.uint32))


@pytest.mark.parametrize("estimate", [
    estimate_creep, pytest.param(estimate_slow_creep, marks=pytest.mark.long)])
@pytest.mark.parametrize("rows", [
    *(pytest.param(rows, marks=pytest.mark.long) for rows in (1.3, 0.9)), 0.4])
def test_no_pole_is_faster_than_the_rows_tell(estimate, rows):
    """A time constant of more than a row is found, one of less than a row is not reported."""
    fast_rad_per_s = 1.0 / (rows * PERIOD_S)
    found = estimate(recording(fast_rad_per_s))
    poles = np.array(found.model.poles_rad_per_s)
    assert poles[0] == pytest.approx(SLOW_RAD_PER_S, rel=0.03)
    if rows > ROWS_OF_DECAY:
        assert poles == pytest.approx((SLOW_RAD_PER_S, fast_rad_per_s), rel=0.03)
    else:
        assert poles.size == 1


def test_what_the_rows_do_not_show_does_not_make_the_rest_faster():
    found = estimate_creep(recording(1.0 / (0.7 * PERIOD_S), 0.5)).model
    assert found.poles_rad_per_s == pytest.approx((SLOW_RAD_PER_S,), rel=0.02)
    [pole], [zero] = found.poles_rad_per_s, found.zeros_rad_per_s
    assert zero / pole - 1.0 == pytest.approx(PART / 1.5, rel=0.03)


def test_creep_faster_than_the_rows_explains_no_noise(recorded):
    """Its inverse makes the noise smaller, and what the hysteresis leaves of it."""
    voltage_v = np.repeat(LEVELS_V, 400)
    part = recorded("noise", voltage_v, np.zeros(voltage_v.size), PERIOD_S, NOISE_UM)
    problem = _Problem([part], 0.0)
    without, beside = (float(np.linalg.norm(problem.residual(point))) for point in (
        np.empty(0), np.log([0.9 / PERIOD_S, 0.9])))
    assert beside > 0.95 * without
