# SPDX-License-Identifier: BSD-3-Clause
"""Modes are not looked for in what only a nonlinear spring leaves."""

import numpy as np

from piezo_identification.estimators.dynamics.fast_record import FastRecord
from piezo_identification.estimators.dynamics.output_error import fit_output_error
from piezo_identification.estimators.poles.pole_responses import HeldInput

PERIOD_S, STEPS = 1.6384e-3, 6
FREQUENCY_RAD_PER_S, DAMPING, CUBIC = 430.0, 0.05, 4.0
SAMPLES, SETTLED = 5000, 200


def multisine():
    lines = np.zeros(SAMPLES // 2 + 1, dtype=complex)
    excited = slice(2, lines.size // 2)
    lines[excited] = np.exp(2j * np.pi * np.random.default_rng(0).random(lines[excited].size))
    wave = np.fft.irfft(lines, SAMPLES)
    return 0.03 * wave / wave.std()


def cubic_spring(inputs):
    """Displacement of a mass on a spring with a cubic part, by Runge and Kutta's rule."""
    w, step = FREQUENCY_RAD_PER_S, PERIOD_S / STEPS

    def push(y, speed, held):
        return w * w * (held - y - CUBIC * y**3) - 2.0 * DAMPING * w * speed

    y = speed = 0.0
    read = np.empty(inputs.size)
    for sample, held in enumerate(inputs):
        read[sample] = y
        for _ in range(STEPS):
            a = push(y, speed, held)
            b_speed = speed + 0.5 * step * a
            b = push(y + 0.5 * step * speed, b_speed, held)
            c_speed = speed + 0.5 * step * b
            c = push(y + 0.5 * step * b_speed, c_speed, held)
            d_speed = speed + step * c
            d = push(y + step * c_speed, d_speed, held)
            y += step / 6.0 * (speed + 2.0 * (b_speed + c_speed) + d_speed)
            speed += step / 6.0 * (a + 2.0 * (b + c) + d)
    return read


def test_a_spring_that_stiffens_is_one_mode_whatever_it_leaves():
    inputs, rows = multisine(), np.arange(SETTLED, SAMPLES - 10)
    noise = 1e-5 * np.random.default_rng(1).normal(size=rows.size)
    measured = cubic_spring(inputs)[rows] + noise
    estimate = fit_output_error(FastRecord(
        HeldInput(inputs, PERIOD_S, False), rows, measured, np.ones((rows.size, 1))))
    assert estimate.residual_rms > 1000.0 * 1e-5
    assert estimate.order.modes + estimate.order.parallel == 1
    assert estimate.order.antiresonances == 0
